"""Start the demo of an installed hostlink, drive its robot over REST, stop it, and end the demo in order.

python3 tools/try_drive.py /usr/bin/hostlink. It needs only Python: tools/try_arm64.sh runs it in an emulated system.
"""

import json
import math
import signal
import subprocess
import sys
import time
import urllib.request
from typing import Any

API = "127.0.0.1:19090"
TIMEOUT_S = 300.0  # an emulated processor is slow
WAY_M = 0.3


def main() -> int:
    program = sys.argv[1]
    print(subprocess.run([program, "--version"], check=True, capture_output=True, text=True).stdout.strip())
    demo = subprocess.Popen([program, "demo", "--listen", "127.0.0.1:0", "--api", API])
    try:
        robot = until(lambda: next((each for each in robots() if each["odometry"]), None))
        began = place(robot)
        print(f"{robot['name']} is connected, at {began}", flush=True)
        until(lambda: drive(robot["name"]) and math.dist(began, place(robots()[0])) > WAY_M)
        print(f"driven over REST to {place(robots()[0])}", flush=True)
        answer = ask("POST", f"robots/{robot['name']}/stop")
        print(f"stopped: {answer['standstill']}", flush=True)
    finally:
        demo.send_signal(signal.SIGINT)
        status = demo.wait(TIMEOUT_S)
    print(f"the demo ended with status {status}")
    return status


def robots() -> list[dict[str, Any]]:
    try:
        found: list[dict[str, Any]] = ask("GET", "robots")["robots"]
    except OSError:  # it does not listen yet
        return []
    return found


def drive(name: str) -> bool:
    """Command one velocity, which lasts for half a second."""
    ask("PUT", f"robots/{name}/velocity", {"linear": 0.2, "angular": 0.0})
    return True


def place(robot: dict[str, Any]) -> tuple[float, float]:
    pose = robot["odometry"]["pose"]
    return round(pose["x_m"], 3), round(pose["y_m"], 3)


def ask(method: str, path: str, body: object = None) -> Any:
    data = None if body is None else json.dumps(body).encode()
    headers = {"Content-Type": "application/json"}
    request = urllib.request.Request(f"http://{API}/api/{path}", data, headers, method=method)
    with urllib.request.urlopen(request, timeout=TIMEOUT_S) as answer:  # noqa: S310 - http
        return json.load(answer)


def until(find: Any) -> Any:
    deadline_s = time.monotonic() + TIMEOUT_S
    while time.monotonic() < deadline_s:
        if found := find():
            return found
        time.sleep(0.1)
    raise TimeoutError(f"no robot that moves within {TIMEOUT_S:g} s")


if __name__ == "__main__":
    sys.exit(main())
