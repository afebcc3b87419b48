"""Commands: which velocities of one ROS 2 topic may drive its robot. Pure."""

LEASE_S = 0.5  # as the daemon's: a velocity holds no longer


class Commands:
    """A stream of velocities that was interrupted drives again after a zero, or a pause as long as a lease.

    | state       | event                                    | next        | then                     |
    |-------------|------------------------------------------|-------------|--------------------------|
    | idle        | a velocity                               | driving     | sent, for this link      |
    | driving     | a velocity                               | driving     | sent, for the same link  |
    | driving     | the device has connected again           | interrupted | refused                  |
    | driving     | `interrupt`: what came may be old        | interrupted | refused                  |
    | interrupted | a velocity within LEASE_S of the last    | interrupted | refused                  |
    | any         | a zero                                   | idle        | sent                     |
    | any         | no velocity for LEASE_S                  | idle        |                          |

    So a device that was reset, a daemon that was restarted and a bridge that stood still move no robot by a stream
    that somebody began before.
    """

    def __init__(self) -> None:
        self.refused = 0
        self._last_s = float("-inf")
        self._link: int | None = None
        self._is_interrupted = False

    def admit(self, *, is_zero: bool, link: int | None, now_s: float) -> bool:
        """Whether this velocity may be sent; `link`: the connection of the robot's device now."""
        if is_zero or now_s > self._last_s + LEASE_S:
            self._is_interrupted, self._link = False, link
        elif link != self._link:
            self._is_interrupted = True
        self._last_s = float("-inf") if is_zero else now_s
        self.refused += self._is_interrupted
        return not self._is_interrupted

    def interrupt(self, now_s: float) -> None:
        """What comes next may have waited, or was meant for another daemon."""
        self._is_interrupted, self._last_s = True, now_s
