"""Bounds and timeouts of connections to the API's port, and evictions."""

from hypothesis import given
from hypothesis import strategies as st

from hostlink.components.gateway.listener import IDLE_TIMEOUT_S, ApiConnection, ApiConnections

HERE, THERE = "127.0.0.1", "10.0.0.5"


def crowd(*, most: int = 4, of_address: int = 3) -> ApiConnections:
    return ApiConnections(most, of_address, request_timeout_s=10.0)


def enter(connections: ApiConnections, address: str, now_s: float = 0.0) -> ApiConnection:
    new, _ = connections.enter(address, now_s)
    assert new is not None
    return new


def test_bound_of_an_address_evicts_its_longest_waiting() -> None:
    connections = crowd()
    first = enter(connections, HERE)
    enter(connections, HERE)
    enter(connections, HERE)
    _, leaving = connections.enter(HERE, 1.0)
    assert leaving is first
    assert len(connections) == 3
    assert connections.closed == {"evicted": 1}


def test_bound_of_all_evicts_from_the_address_with_most_waiting() -> None:
    connections = crowd()
    enter(connections, HERE)
    attacker = enter(connections, THERE)
    enter(connections, THERE)
    enter(connections, THERE)
    _, leaving = connections.enter(HERE, 1.0)
    assert leaving is attacker


def test_connection_being_answered_is_never_evicted() -> None:
    connections = crowd()
    for _ in range(3):
        connections.serve(enter(connections, HERE))
    assert connections.enter(HERE, 0.0) == (None, None)
    assert connections.closed == {"too_many_of_address": 1}
    connections.serve(enter(connections, THERE))
    assert connections.enter("10.0.0.6", 0.0) == (None, None)
    assert connections.closed == {"too_many_of_address": 1, "too_many": 1}


def test_incomplete_request_and_idle_connection_time_out() -> None:
    connections = crowd()
    half, idle = enter(connections, HERE), enter(connections, HERE)
    connections.serve(idle)
    connections.wait(idle, 5.0)
    assert connections.overdue(9.9) == []
    assert connections.overdue(10.0) == [half]
    assert connections.overdue(5.0 + IDLE_TIMEOUT_S - 0.1) == []
    assert connections.overdue(5.0 + IDLE_TIMEOUT_S) == [idle]
    assert len(connections) == 0
    assert connections.closed == {"timeout": 2}


def test_closed_connection_does_not_wait_again() -> None:
    connections = crowd()
    gone = enter(connections, HERE)
    connections.serve(gone)
    connections.leave(gone)
    connections.wait(gone, 1.0)
    assert connections.overdue(1000.0) == []
    assert len(connections) == 0


steps = st.lists(st.tuples(st.sampled_from(["enter", "serve", "wait", "leave"]), st.integers(0, 9)), max_size=200)


@given(steps, st.integers(1, 6), st.integers(1, 6))
def test_bounds_are_kept_and_complete_requests_are_never_evicted(
    script: list[tuple[str, int]], most: int, of_address: int
) -> None:
    connections = crowd(most=most, of_address=of_address)
    here: list[ApiConnection] = []  # oldest first
    served: set[ApiConnection] = set()
    for step, choice in script:
        chosen = here[choice % len(here)] if here else None
        if step == "enter":
            address = f"10.0.0.{choice % 3}"
            mine = [each for each in here if each.address == address]
            new, leaving = connections.enter(address, 0.0)
            if leaving is not None:
                assert leaving not in served
                here.remove(leaving)
            if new is None:
                assert served.issuperset(mine if len(mine) >= of_address else here)
            else:
                here.append(new)
        elif chosen is not None and step == "serve":
            connections.serve(chosen)
            served.add(chosen)
        elif chosen is not None and step == "wait":
            connections.wait(chosen, 0.0)
            served.discard(chosen)
        elif chosen is not None:
            here.remove(chosen)
            connections.leave(chosen)
            served.discard(chosen)
        assert len(connections) == len(here) <= most
        assert all(sum(each.address == one.address for each in here) <= of_address for one in here)
