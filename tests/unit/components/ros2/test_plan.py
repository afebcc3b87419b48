"""Routes that two graphs need."""

from typing import Any

from hostlink.components.graphs.ros2_qos import Qos
from hostlink.components.ros2.plan import (
    TWIST,
    TWIST_STAMPED,
    Caller,
    Feed,
    PublicationRoute,
    Reception,
    Ros2Graph,
    Ros2Publisher,
    Server,
    VelocityInput,
    planned,
    watched_topics,
)

RELIABLE, LATCHED = Qos(is_reliable=True, is_latched=False), Qos(is_reliable=True, is_latched=True)


def topic(name: str, type_name: str = "std_msgs/String", **flags: bool) -> dict[str, Any]:
    default = dict.fromkeys(("published", "subscribed", "latched", "velocity"), False)
    return {"name": name, "type": type_name, **default, **flags}


def graph(*topics: dict[str, Any], robots: Any = (), services: Any = ()) -> dict[str, Any]:
    return {"topics": list(topics), "robots": list(robots), "services": list(services)}


def robot(name: str = "robot_0", **velocity_topics: str) -> dict[str, Any]:
    topics = {f"/{name}/{topic}": type_name for topic, type_name in velocity_topics.items()}
    return {"name": name, "link": 1, "velocity_topics": topics}


def test_topic_of_the_daemon_is_fed_only_while_it_has_a_reader() -> None:
    daemon = graph(topic("/robot_0/odom", "nav_msgs/Odometry", published=True))
    publication = PublicationRoute("/robot_0/odom", "nav_msgs/Odometry", is_latched=False)
    assert planned(daemon, Ros2Graph()).routes == {publication}
    read = Ros2Graph(readers=frozenset({"/robot_0/odom"}))
    assert planned(daemon, read).routes == {publication, Feed(publication)}


def test_a_latched_topic_is_fed_before_anybody_reads_it() -> None:
    daemon = graph(topic("/map", "nav_msgs/OccupancyGrid", published=True, latched=True))
    assert (
        Feed(PublicationRoute("/map", "nav_msgs/OccupancyGrid", is_latched=True)) in planned(daemon, Ros2Graph()).routes
    )


def test_subscribed_topic_is_received_with_the_qos_of_its_publishers() -> None:
    ros2 = Ros2Graph(publishers={"/map": (Ros2Publisher("nav_msgs/msg/OccupancyGrid", LATCHED),)})
    found = planned(graph(topic("/map", "", subscribed=True)), ros2).routes
    assert [(each.ros2_type, each.type_name, each.qos.is_latched) for each in found if isinstance(each, Reception)] == [
        ("nav_msgs/msg/OccupancyGrid", "nav_msgs/OccupancyGrid", True)
    ]


def test_topic_without_publisher_or_subscriber_is_not_received() -> None:
    ros2 = Ros2Graph(publishers={"/a": (), "/b": (Ros2Publisher("std_msgs/msg/String", RELIABLE),)})
    daemon = graph(topic("/a", subscribed=True), topic("/b", published=True))
    assert not [each for each in planned(daemon, ros2).routes if isinstance(each, Reception)]


def test_two_types_of_one_name_are_reported_and_not_received() -> None:
    ros2 = Ros2Graph(publishers={"/a": (Ros2Publisher("std_msgs/msg/Int32", RELIABLE),)})
    plan = planned(graph(topic("/a", subscribed=True)), ros2)
    assert plan.routes == frozenset()
    assert plan.problems == ("/a: std_msgs/String here, std_msgs/msg/Int32 in ROS 2: it is not received",)


def test_a_name_that_ros_2_refuses_is_reported_and_touches_no_other() -> None:
    plan = planned(graph(topic("/2wheels/odom", published=True), topic("/a", published=True)), Ros2Graph())
    assert plan.routes == {PublicationRoute("/a", "std_msgs/String", is_latched=False)}
    assert "/2wheels/odom" in plan.problems[0]


def test_a_velocity_topic_is_an_input_and_never_published_or_received() -> None:
    velocity = topic("/robot_0/cmd_vel", "geometry_msgs/Twist", published=True, subscribed=True, velocity=True)
    ros2 = Ros2Graph(
        publishers={"/robot_0/cmd_vel": (Ros2Publisher(TWIST, RELIABLE),)}, readers=frozenset({"/robot_0/cmd_vel"})
    )
    daemon = graph(velocity, robots=[robot(cmd_vel="geometry_msgs/Twist")])
    assert planned(daemon, ros2).routes == {VelocityInput("/robot_0/cmd_vel", "robot_0", TWIST)}
    assert watched_topics(daemon) == ["/robot_0/cmd_vel"]


def test_cmd_vel_has_the_type_that_ros_2_sends() -> None:
    daemon = graph(robots=[robot(cmd_vel="geometry_msgs/Twist")])

    def type_with(*types: str) -> list[str]:
        ends = tuple(Ros2Publisher(type_name, RELIABLE) for type_name in types)
        routes = planned(daemon, Ros2Graph(publishers={"/robot_0/cmd_vel": ends})).routes
        return [each.ros2_type for each in routes if isinstance(each, VelocityInput)]

    assert type_with() == type_with(TWIST) == type_with(TWIST, TWIST_STAMPED) == [TWIST]
    assert type_with(TWIST_STAMPED) == [TWIST_STAMPED]
    assert type_with("std_msgs/msg/String") == [TWIST]


def test_a_topic_drives_one_robot() -> None:
    both = [robot("a"), robot("b")]
    for each in both:
        each["velocity_topics"] = {"/cmd_vel": "geometry_msgs/Twist"}
    assert planned(graph(robots=both), Ros2Graph()).routes == {VelocityInput("/cmd_vel", "a", TWIST)}


def test_services_go_both_ways_and_none_of_a_node_s_own() -> None:
    untyped = {"name": "/robot_0/ask", "type": ""}  # no program has told its type
    daemon = graph(services=[{"name": "/robot_0/lock", "type": "std_srvs/Trigger"}, untyped])
    ros2 = Ros2Graph(
        services={
            "/add": "example_interfaces/srv/AddTwoInts",
            "/robot_0/lock": "std_srvs/srv/Trigger",
            "/node/get_parameters": "rcl_interfaces/srv/GetParameters",
        }
    )
    assert planned(daemon, ros2).routes == {
        Server("/robot_0/lock", "std_srvs/Trigger"),
        Caller("/add", "example_interfaces/srv/AddTwoInts"),
    }


def test_cdr_of_a_type_without_a_definition_is_published_and_not_received() -> None:
    own = {**topic("/own", "my_msgs/Own", published=True, subscribed=True), "encoding": "cdr"}
    ros2 = Ros2Graph(publishers={"/own": (Ros2Publisher("my_msgs/msg/Own", RELIABLE),)}, readers=frozenset({"/own"}))
    publication = PublicationRoute("/own", "my_msgs/Own", is_latched=False, is_cdr=True)
    plan = planned(graph(own), ros2)
    assert plan.routes == {publication, Feed(publication)}
    assert plan.problems == ("/own: my_msgs/Own has no definition here: it is not received from ROS 2",)
