"""Given samples of a daemon, does DaemonRecord flag each budget that is broken, once?"""

import dataclasses

import pytest

from tests.support.chaos.daemon_record import MIB, DaemonRecord, Health, Sample
from tests.support.chaos.limits import Limits
from tests.support.chaos.noise import Noise

LIMITS = Limits()
FIRST = Sample(at_s=100.0, memory_bytes=70 * MIB, log_bytes=1000, descriptors=12, descriptors_most=1024)


@pytest.fixture
def record() -> DaemonRecord:
    made = DaemonRecord(LIMITS, Noise(stretch_most=3.0))
    made.add_sample(FIRST)
    return made


def promises(record: DaemonRecord) -> list[str]:
    return [violation.promise for violation in record.check()]


def later(**changes: float) -> Sample:
    return dataclasses.replace(FIRST, at_s=110.0, **changes)


def test_a_daemon_within_its_budgets_has_no_violation(record: DaemonRecord) -> None:
    record.add_sample(later(memory_bytes=90 * MIB, log_bytes=500_000, descriptors=400))
    record.add_health(Health(110.0, 0.1, 200))
    record.add_robots([True] * 50 + [False] * 20, 110.0)
    assert promises(record) == []
    assert record.most_memory_bytes == 90 * MIB


@pytest.mark.parametrize(
    ("changes", "promise"),
    [
        ({"memory_bytes": 300 * MIB}, "memory, MiB"),
        ({"memory_bytes": int((71 + LIMITS.growth_mib) * MIB)}, "growth of memory, MiB"),
        ({"log_bytes": int(LIMITS.log_bytes + 10 * LIMITS.log_bytes_s) + 1}, "log, bytes"),
        ({"descriptors": 1020}, "descriptors"),
    ],
)
def test_a_broken_budget_is_found(record: DaemonRecord, changes: dict[str, int], promise: str) -> None:
    record.add_sample(later(**changes))
    assert promise in promises(record)


def test_a_budget_that_stays_broken_is_one_violation_until_it_is_kept_again(record: DaemonRecord) -> None:
    for descriptors in (1020, 1024, 100, 1020):
        record.add_sample(later(descriptors=descriptors))
    assert promises(record) == ["descriptors", "descriptors"]


def test_the_log_may_grow_with_time(record: DaemonRecord) -> None:
    size = int(LIMITS.log_bytes + 10 * LIMITS.log_bytes_s) + 1
    record.add_sample(dataclasses.replace(FIRST, at_s=111.0, log_bytes=size))
    assert promises(record) == []


@pytest.mark.parametrize(
    ("health", "promise"),
    [
        (Health(100.0, 3.0, 200), "/healthz answers, s"),
        (Health(100.0, 10.0, 0), "/healthz answers, s"),
        (Health(100.0, 0.1, 0), "/healthz answers 200"),
        (Health(100.0, 0.1, 503), "/healthz answers 200"),
    ],
)
def test_health_that_is_late_or_wrong_is_found(record: DaemonRecord, health: Health, promise: str) -> None:
    record.add_health(health)
    assert promises(record) == [promise]


def test_a_daemon_that_waits_for_a_core_is_given_longer(record: DaemonRecord) -> None:
    record.add_sample(later(ran_s=5.0, waited_s=5.0))
    record.add_health(Health(101.0, 3.0, 200))
    assert promises(record) == []


def test_robots_that_are_never_forgotten_are_found(record: DaemonRecord) -> None:
    record.add_robots([True] * int(LIMITS.robots + 1), 101.0)
    assert promises(record) == ["robots known"]
    record.add_robots([True] * 60 + [False] * int(LIMITS.robots_gone + 1), 101.0)
    assert promises(record) == ["robots known that are gone"]


@pytest.mark.parametrize(
    ("text", "cause"),
    [
        (b'Traceback (most recent call last):\n  File "x.py", line 1\nKeyError: \'pose\'\n', "KeyError: 'pose'"),
        (b'{"exception": "Traceback (most recent call last):\\nValueError: no"}\n', "ValueError: no"),
        (b"  | Exception Group Traceback (most recent call last):\n", "unknown"),
        (b'{"event": "link.crashed"}\n', "unknown"),
    ],
)  # fmt: skip
def test_a_crash_in_the_log_is_found_with_its_cause(record: DaemonRecord, text: bytes, cause: str) -> None:
    record.add_log(text, 101.0)
    record.add_log(text, 102.0)
    (violation,) = record.check()
    assert violation.promise == "no traceback in the log"
    assert violation.detail.startswith(cause)


def test_log_with_errors_is_not_a_crash(record: DaemonRecord) -> None:
    record.add_log(b'{"event": "link.closed", "reason": "broken", "cause": "ConnectionError: reset"}\n', 101.0)
    assert promises(record) == []


def test_memory_and_descriptors_settle_once_everybody_has_left(record: DaemonRecord) -> None:
    assert record.settle() == []
    record.add_sample(later(memory_bytes=int((71 + LIMITS.settled_mib) * MIB), descriptors=100))
    found = {violation.promise for violation in record.settle()}
    assert found == {"memory settles, MiB of growth", "descriptors settle"}


def test_daemon_without_samples_has_not_settled() -> None:
    assert DaemonRecord(LIMITS, Noise(stretch_most=3.0)).settle() != []
