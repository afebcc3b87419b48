"""What the master is to know, and what it knows."""

from hostlink.graphs.ros1.registrations import Kind, Registration, Registrations

ODOM = Registration(Kind.PUBLISHER, "/odom", "nav_msgs/Odometry")
CMD = Registration(Kind.SUBSCRIBER, "/cmd_vel", "geometry_msgs/Twist")
STOP = Registration(Kind.SERVICE, "/stop", "std_srvs/Trigger")


def registered() -> Registrations:
    found = Registrations()
    found.wanted = dict.fromkeys((ODOM, CMD, STOP))
    for each in found.missing():
        found.note(each)
    return found


def test_services_are_registered_first() -> None:
    found = Registrations()
    found.wanted = dict.fromkeys((ODOM, CMD, STOP))
    assert found.missing() == [STOP, ODOM, CMD]


def test_what_is_known_is_not_missing() -> None:
    assert registered().missing() == registered().surplus() == []


def test_what_is_wanted_no_more_is_surplus() -> None:
    found = registered()
    found.wanted = dict.fromkeys((CMD,))
    assert found.surplus() == [STOP, ODOM]
    found.forget(ODOM)
    found.forget(ODOM)
    assert found.surplus() == [STOP]


def test_another_type_is_registered_over_the_one_before() -> None:
    found = registered()
    pose = ODOM._replace(type_name="geometry_msgs/Pose2D")
    found.wanted = dict.fromkeys((pose, CMD, STOP))
    assert found.surplus() == []
    assert found.missing() == [pose]
    found.note(pose)
    assert found.missing() == []
    assert ODOM not in found.known


def test_what_the_master_has_forgotten_is_missing_again() -> None:
    found = registered()
    assert found.keep({Kind.PUBLISHER: set(), Kind.SUBSCRIBER: {"/cmd_vel", "/other"}, Kind.SERVICE: set()}) == 2
    assert found.missing() == [STOP, ODOM]
    found.forget_all()
    assert found.missing() == [STOP, ODOM, CMD]
