"""The engine that keeps one graph equal to another. A new graph is one adapter of it.

An adapter does four things, and `tests/unit/core/mirror/test_toy_graph.py` shows a complete one in 60 lines:

1. It **lists** what is wanted: after each change of a graph it passes the topics or services that the other graph
   should have to `Mirror.want`, as a dictionary of keys and specifications. Two equal specifications of one key are
   one endpoint. For one change of a large graph, it passes that key to `Mirror.put`.
2. It **opens** an endpoint: the first argument of `Mirror` is a function of key and specification that returns an
   object with `close`. It raises when the endpoint cannot be opened. An endpoint that takes time to open, or that can
   end by itself, is a coroutine, and the mirror is `Mirror.of_tasks`.
3. It **closes** an endpoint: `close` of that object withdraws it at once and does not wait. A coroutine is cancelled.
4. It **converts** payloads: the endpoint receives the messages of one graph and publishes them in the other. Messages
   from other threads pass through a `ThreadInbox`, which has a bounded queue for each source.

The adapter joins the hub as a participant with a group (`Hub.join`): what the group publishes is not sent back to it.
`Participant.watch_graph` reports each change of the hub's graph, `Participant.graph` returns it.

The engine does everything else:

- It closes endpoints that are no longer wanted, or that have another specification, before it opens any.
- An endpoint that cannot be opened affects no other one. Its error is passed to `on_failure`; `LogOnce` logs it once.
- The number of open endpoints is bounded, in all and for each peer (`limit`, `group_limit`), because peers decide how
  much is wanted.

Five adapters use it: ROS 1 (topics, services, connections to publishers, registrations at the master), ROS 2 by rclpy
(routes), ROS 2 by Zenoh (topics, services, remote publishers), the fleet (exported and imported topics) and the
recorder (subscriptions). They differ in these arguments of `Reconciler` and `Mirror`:

| difference                           | argument                    | adapter                                |
|--------------------------------------|-----------------------------|----------------------------------------|
| opening takes time, or may end       | `Mirror.of_tasks`           | rclpy; ROS 1: services, publishers     |
| a failure is tried again             | `retry_s`, `longest_s`      | these, registrations, fleet, recorder  |
| a new specification needs no closing | `replaces`                  | registrations                          |
| another specification is the same    | `is_same`                   | ROS 1: a type that was learned; Zenoh  |
| a bound for each peer                | `group_of`, `group_limit`   | ROS 1: of a topic; Zenoh: of a session |
| one change of a large graph          | `put` instead of `want`     | recorder; publishers of ROS 1, Zenoh   |
| opening costs loop time              | `slice_s`                   | Zenoh, the fleet                       |
| one peer takes all requests in order | `Reconciler` without Mirror | registrations                          |
| the peer forgets what was opened     | `forget`                    | registrations                          |
"""
