"""The engine that keeps one graph equal to another. An adapter lists, opens and closes endpoints; all else is here.

Five adapters use it: ROS 1 (topics, services, connections to publishers, registrations at the master), ROS 2 by rclpy
(routes), ROS 2 by Zenoh (topics, services, remote publishers), the fleet (exported and imported topics) and the
recorder (subscriptions). Foxglove's directory opens nothing: it numbers what there is. They have this in common:

- Somebody lists what is wanted, by a key; two specifications of one key that are equal are one endpoint.
- What is not wanted any more, or has another specification, is closed before anything is opened.
- An endpoint that cannot be opened affects no other one. Its reason is logged once (`LogOnce`).
- Peers decide how much is wanted, so how much is open is bounded, in all and for each of them (`limit`, `group_limit`).
- What other threads deliver waits in a bounded queue for each source (`Inbox`).

They differ in these points, which are arguments of `Reconciler` and `Mirror`:

| difference                           | argument                    | where                                  |
|--------------------------------------|-----------------------------|----------------------------------------|
| opening takes time, or may end       | `Mirror.of_tasks`           | rclpy; ROS 1: services, publishers     |
| a failure is tried again             | `retry_s`, `longest_s`      | these, registrations, fleet, recorder  |
| a new specification needs no closing | `replaces`                  | registrations                          |
| another specification is the same    | `is_same`                   | ROS 1: a type that was learned         |
| a bound for each peer                | `group_of`, `group_limit`   | ROS 1: of a topic; Zenoh: of a session |
| one change of a large graph          | `put` instead of `want`   | recorder; publishers of ROS 1, Zenoh   |
| opening costs loop time              | `slice_s`                   | Zenoh, the fleet                       |
| one peer takes all requests in order | `Reconciler` without Mirror | registrations                          |
| the peer forgets what was opened     | `forget`                    | registrations                          |
"""
