"""A short run of libFuzzer on the generated headers; `make fuzz` runs it on those of all types, for a minute."""

import subprocess
from pathlib import Path

from tests.support.headers_fuzzer import compile_fuzzer

TYPES = ("diagnostic_msgs/DiagnosticArray", "sensor_msgs/JointState", "sensor_msgs/PointCloud2", "std_srvs/Trigger")


def test_the_headers_keep_their_laws_for_some_thousand_payloads(tmp_path: Path) -> None:
    program = compile_fuzzer(tmp_path, TYPES)
    limits = ["-runs=20000", "-seed=1", "-max_len=512", f"-artifact_prefix={tmp_path}/"]
    done = subprocess.run([program, *limits, tmp_path / "seeds"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
