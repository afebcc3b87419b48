"""Which velocities of a stream may drive after a lock."""

from hostlink.robot.locked_streams import MAX_STREAMS, LockedStreams

LEASE_S = 0.5


def admits(
    ours: LockedStreams, now_s: float, *, owner: str = "nav", is_zero: bool = False, locked: bool = False
) -> bool:
    return ours.admit(owner, is_zero=is_zero, is_locked=locked, now_s=now_s, lease_s=LEASE_S)


def test_a_stream_that_met_no_lock_drives() -> None:
    ours = LockedStreams()
    assert all(admits(ours, 0.1 * number) for number in range(20))


def test_a_stream_that_went_on_through_a_lock_does_not_drive_behind_it() -> None:
    ours = LockedStreams()
    assert not admits(ours, 1.0, locked=True)
    assert not any(admits(ours, 1.0 + 0.4 * number) for number in range(1, 20))


def test_a_zero_begins_anew_also_while_the_robot_is_locked() -> None:
    ours = LockedStreams()
    assert not admits(ours, 1.0, locked=True)
    assert admits(ours, 1.1, is_zero=True, locked=True)
    assert admits(ours, 1.2)


def test_a_pause_as_long_as_a_lease_begins_anew() -> None:
    ours = LockedStreams()
    assert not admits(ours, 1.0, locked=True)
    assert not admits(ours, 1.4)
    assert admits(ours, 1.4 + LEASE_S)
    assert admits(ours, 2.0)


def test_another_stream_is_none_of_its_business() -> None:
    ours = LockedStreams()
    assert not admits(ours, 1.0, locked=True)
    assert admits(ours, 1.1, owner="page")
    assert not admits(ours, 1.2)


def test_of_too_many_the_one_is_forgotten_that_published_the_longest_ago() -> None:
    ours = LockedStreams()
    for number in range(MAX_STREAMS + 1):
        assert not admits(ours, 1.0, owner=f"nav {number}", locked=True)
    assert admits(ours, 1.1, owner="nav 0")
    assert not admits(ours, 1.1, owner="nav 1")
