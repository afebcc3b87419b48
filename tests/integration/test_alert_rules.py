"""The alert rules in Prometheus' own evaluation: each fires on its condition, and none on a daemon without trouble."""

import json
import re
import subprocess
from pathlib import Path

import pytest
import yaml
from prometheus_client.parser import text_string_to_metric_families

from hostlink.components.recorder.settings import RecordingConfig
from hostlink.core.config import Config
from tests.support.daemon import daemon
from tests.support.device_reports import BATTERY, battery
from tests.support.fake_device import fake_device, pose, robot_topics
from tests.support.waiting import expect

RULES_FILE = Path("docs/prometheus-alerts.yml")
RULES = {rule["alert"]: rule for rule in yaml.safe_load(RULES_FILE.read_text(encoding="utf-8"))["groups"][0]["rules"]}
MINUTES = 30
STEP_S = 5
SAMPLES = MINUTES * 60 // STEP_S

WELL = {
    'up{job="hostlink"}': "1x{n}",
    'process_start_time_seconds{job="hostlink"}': "7x{n}",
    'hostlink_crashes_total{what="robot"}': "1x{n}",
    'hostlink_robot_connected{robot="r"}': "1x{n}",
    'hostlink_robot_locked{robot="r"}': "0x{n}",
    'hostlink_robot_driven{robot="r"}': "1x{n}",
    'hostlink_robot_odometry_age_seconds{robot="r"}': "0.1x{n}",
    'hostlink_robot_commanded_speed{robot="r", axis="linear"}': "-0.2x{n}",
    'hostlink_robot_speed{robot="r", axis="linear"}': "-0.2x{n}",
    'hostlink_robot_battery_volts{robot="r"}': "7.4x{n}",
    'hostlink_link_rejected_total{robot="r", peer="p", cause="checksum"}': "0+1x{n}",
    'hostlink_command_to_device_seconds_bucket{robot="r", le="0.01"}': "0+100x{n}",
    'hostlink_command_to_device_seconds_bucket{robot="r", le="1.0"}': "0+100x{n}",
    'hostlink_command_to_device_seconds_bucket{robot="r", le="+Inf"}': "0+100x{n}",
    'hostlink_connections_refused_total{cause="crowd"}': "5x{n}",
    "hostlink_log_lines_lost_total": "3x{n}",
    "hostlink_recordings_failed_total": "1x{n}",
    "hostlink_recording_dropped_total": "9x{n}",
    "hostlink_black_box_dropped_total": "9x{n}",
    'hostlink_disk_free_bytes{folder="recordings"}': "3000x{n}",
    'hostlink_disk_min_free_bytes{folder="recordings"}': "1000x{n}",
    'hostlink_incidents_total{outcome="saved"}': "0+1x{n}",
    'hostlink_incidents_total{outcome="failed"}': "1x{n}",
}
GROWS = "0+1x{n}"
TROUBLE = {
    "HostlinkDown": {'up{job="hostlink"}': "0x{n}"},
    "HostlinkRestarts": {'process_start_time_seconds{job="hostlink"}': "0+5x{n}"},
    "HostlinkFault": {'hostlink_crashes_total{what="robot"}': GROWS},
    "RobotGone": {'hostlink_robot_connected{robot="r"}': "0x{n}"},
    "RobotDrivenWithoutOdometry": {'hostlink_robot_odometry_age_seconds{robot="r"}': "1.5x{n}"},
    "RobotLockedForLong": {'hostlink_robot_locked{robot="r"}': "1x{n}"},
    "RobotDoesNotFollow": {'hostlink_robot_speed{robot="r", axis="linear"}': "0x{n}"},
    "RobotBatteryLow": {'hostlink_robot_battery_volts{robot="r"}': "6.3x{n}"},
    "LinkDamaged": {'hostlink_link_rejected_total{robot="r", peer="p", cause="checksum"}': "0+10x{n}"},
    "CommandsLate": {'hostlink_command_to_device_seconds_bucket{robot="r", le="0.01"}': "0+10x{n}"},
    "DevicesRefused": {'hostlink_connections_refused_total{cause="crowd"}': GROWS},
    "LogLinesLost": {"hostlink_log_lines_lost_total": GROWS},
    "RecordingFailed": {"hostlink_recordings_failed_total": GROWS},
    "RecordingLosesMessages": {"hostlink_recording_dropped_total": GROWS},
    "BlackBoxTooSmall": {"hostlink_black_box_dropped_total": GROWS},
    "RecordingDiskNearlyFull": {'hostlink_disk_free_bytes{folder="recordings"}': "1900x{n}"},
    "IncidentLost": {'hostlink_incidents_total{outcome="failed"}': GROWS},
}


def scenario(name: str, firing: list[str], trouble: dict[str, str]) -> dict[str, object]:
    """A test of promtool: the alerts that fire after half an hour of these series."""
    series = [
        {"series": _of_instance(each), "values": values.format(n=SAMPLES)} for each, values in (WELL | trouble).items()
    ]
    query = 'count by (alertname) (ALERTS{alertstate="firing"})'
    samples = [{"labels": f'{{alertname="{each}"}}', "value": 1} for each in firing]
    return {
        "name": name,
        "interval": f"{STEP_S}s",
        "input_series": series,
        "promql_expr_test": [{"expr": query, "eval_time": f"{MINUTES}m", "exp_samples": samples}],
    }


def _of_instance(series: str) -> str:
    return series.replace("{", '{instance="a", ', 1) if "{" in series else series + '{instance="a"}'


def test_each_rule_has_a_trouble_on_which_it_fires() -> None:
    assert TROUBLE.keys() == RULES.keys()
    for name, trouble in TROUBLE.items():
        metrics = set(re.findall(r"\b(?:up|process_\w+|hostlink_\w+)\b(?!\")", RULES[name]["expr"]))
        assert trouble.keys() <= WELL.keys()
        assert {each.partition("{")[0] for each in trouble} <= metrics, name


async def test_series_of_the_scenarios_have_the_labels_that_the_daemon_exports(tmp_path: Path) -> None:
    exported: dict[str, set[str]] = {"up": {"job"}, "process_start_time_seconds": {"job"}}  # by Prometheus itself
    config = Config().with_tables(recording=RecordingConfig(folder=tmp_path))
    async with daemon(config) as host, fake_device(host.tcp, [*robot_topics(), BATTERY]) as device:
        await device.send(b"\xff\xfe" + bytes(20) + pose(1.0, 2.0, 0.5) + battery(7.5))
        await expect(lambda: host.hub.robots.find("robot_0").battery is not None)
        host.hub.counts.refused["test"] += 1
        host.hub.isolation.crashes["test"] += 1
        async with host.session.get(host.url + "/metrics") as response:
            text = await response.text()
    for family in text_string_to_metric_families(text):
        for sample in family.samples:
            exported.setdefault(sample.name, set()).update(sample.labels)
    for series in WELL:
        name, _, labels = series.partition("{")
        assert set(re.findall(r"(\w+)=", labels)) <= exported[name], series


@pytest.fixture
def promtool() -> str:
    """Prometheus' tool, which is not run where it is missing (tests/support/requirements.py)."""
    return "build/promtool/usr/bin/promtool"


@pytest.mark.long
def test_each_rule_fires_on_its_trouble_only(promtool: str, tmp_path: Path) -> None:
    tests = [scenario("no trouble", [], {})]
    tests += [scenario(name, [name], trouble) for name, trouble in TROUBLE.items()]
    file = tmp_path / "rules.json"  # which is YAML too
    content = {"rule_files": [str(RULES_FILE.resolve())], "evaluation_interval": f"{STEP_S}s", "tests": tests}
    file.write_text(json.dumps(content), encoding="utf-8")
    done = subprocess.run([promtool, "test", "rules", str(file)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
