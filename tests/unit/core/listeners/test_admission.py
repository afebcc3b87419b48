"""ConnectionAdmission: accepted, refused and evicted connections."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.core.config import TcpConfig
from hostlink.core.listeners.accepting import ConnectionAdmission, OpenConnection, Verdict

ROBOT, OTHER, CROWD = "192.168.4.2", "192.168.4.3", "10.0.0.1"


def connections(*entries: tuple[str, bool]) -> list[OpenConnection]:
    return [
        OpenConnection(number, address, is_identified=is_identified)
        for number, (address, is_identified) in enumerate(entries)
    ]


@pytest.mark.parametrize(
    ("allow", "address", "refusal"),
    [
        ((), ROBOT, None),
        (("192.168.4.0/24",), ROBOT, None),
        (("10.0.0.0/8", "192.168.4.2"), ROBOT, None),
        (("192.168.4.0/24",), "192.168.5.2", "not_allowed"),
        (("192.168.4.0/24",), "::1", "not_allowed"),
        (("fe80::/10",), "fe80::1%eth0", None),
        (("::/0",), ROBOT, "not_allowed"),
    ],
)
def test_connection_from_outside_the_allowed_networks_is_refused(
    allow: tuple[str, ...], address: str, refusal: str | None
) -> None:
    assert ConnectionAdmission(TcpConfig(allow=allow)).judge(address, []) == Verdict(refusal=refusal)


def test_connections_of_one_address_are_limited() -> None:
    admission = ConnectionAdmission(TcpConfig(max_connections_per_address=2))
    there = connections((ROBOT, True), (ROBOT, False))
    assert admission.judge(ROBOT, there) == Verdict(refusal="too_many_of_address")
    assert admission.judge(OTHER, there) == Verdict()


def test_oldest_unidentified_connection_of_the_fullest_address_is_evicted() -> None:
    admission = ConnectionAdmission(TcpConfig(max_connections=6))
    there = connections((CROWD, True), (OTHER, False), (CROWD, False), (CROWD, False), (ROBOT, True), (CROWD, False))
    assert admission.judge(ROBOT, there) == Verdict(evicts=2)


def test_crowd_of_one_address_does_not_evict_itself() -> None:
    """Accepting a connection costs more than refusing one."""
    admission = ConnectionAdmission(TcpConfig(max_connections=4))
    there = connections((CROWD, False), (OTHER, False), (CROWD, False), (OTHER, False))
    assert admission.judge(CROWD, there) == Verdict(refusal="too_many")
    assert (
        admission.judge(CROWD, connections((CROWD, False), *[(OTHER, False)] * 2, (ROBOT, True))).refusal == "too_many"
    )
    assert admission.judge(CROWD, connections((CROWD, False), *[(OTHER, False)] * 3)) == Verdict(evicts=1)
    assert admission.judge(ROBOT, there) == Verdict(evicts=0)
    assert admission.judge(ROBOT, connections(*[(f"10.0.0.{last}", False) for last in range(4)])) == Verdict(evicts=0)


def test_no_identified_connection_is_evicted() -> None:
    admission = ConnectionAdmission(TcpConfig(max_connections=2))
    assert admission.judge(CROWD, connections((ROBOT, True), (OTHER, True))) == Verdict(refusal="too_many")


@given(st.lists(st.tuples(st.sampled_from([ROBOT, OTHER, CROWD]), st.booleans()), max_size=60))
def test_bounds_hold_and_robots_stay_for_any_connections(arrivals: list[tuple[str, bool]]) -> None:
    config = TcpConfig(max_connections=5, max_connections_per_address=3)
    admission = ConnectionAdmission(config)
    there: list[OpenConnection] = []
    robots = set()
    for number, (address, is_identified) in enumerate(arrivals):
        verdict = admission.judge(address, there)
        there = [connection for connection in there if connection.number != verdict.evicts]
        if verdict.refusal is None:
            there.append(OpenConnection(number, address, is_identified=is_identified))
            robots |= {number} if is_identified else set()
        assert len(there) <= config.max_connections
        assert sum(connection.address == address for connection in there) <= config.max_connections_per_address
        assert robots <= {connection.number for connection in there}


@pytest.mark.parametrize("network", ["192.168.4.2/24", "robots"])
def test_invalid_network_is_refused(network: str) -> None:
    with pytest.raises(ValueError, match=network):
        TcpConfig(allow=(network,))
