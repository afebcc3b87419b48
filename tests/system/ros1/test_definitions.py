"""Every type here against ROS 1's own generator: md5 sums, definitions and payloads; also of unusual definitions."""

import json
import subprocess
from pathlib import Path
from random import Random
from typing import Any

from hostlink.core.messages.catalog import Catalog
from tests.support.random_messages import random_message, random_package
from tests.support.ros1.debian import PYTHON

MESSAGES = Path(__file__).parents[2] / "support" / "ros1" / "messages.py"
UNUSUAL = {
    "unusual/Comments": "# a \x0c form feed, \x85 and \u2028\nuint8 x # = 3\n",
    "unusual/Texts": "string A=a # no comment \"b\" 'c' = d\nstring B=\nstring  C  =  spaces  \nstring D=\u2028#\n",
    "unusual/Numbers": "bool A=True\nbool B=+1\nint32 C=1_000\nfloat32 D=-0\nfloat64 E=5e-324\nchar F=65\nbyte G=-1\n",
    "unusual/Keywords": "uint8 class\nuint8 PI\nHeader header\ntime[2] stamps\nduration[] waits\nbool[3] switches\n",
    "unusual/Nested": "Keywords[2] a\ngeometry_msgs/Pose[] b\nstd_msgs/Empty[] c\nTexts d",
}


def definitions(folder: Path) -> Catalog:
    """The types that are built in, UNUSUAL and drawn ones."""
    texts = UNUSUAL | random_package(Random(1), "drawn")
    for name, text in texts.items():
        path = folder / f"{name}.msg"
        path.parent.mkdir(exist_ok=True)
        path.write_text(text, newline="\r\n")
    return Catalog([folder])


def answer_of_ros(request: dict[str, Any], folder: Path) -> dict[str, Any]:
    environment = {"TMPDIR": str(folder)}  # the generator leaves its modules there
    done = subprocess.run(
        [PYTHON, MESSAGES], input=json.dumps(request), capture_output=True, text=True, check=False, env=environment
    )
    assert done.returncode == 0, done.stderr
    answer: dict[str, Any] = json.loads(done.stdout)
    return answer


def test_every_type_has_the_md5_sum_the_definition_and_the_payloads_of_ros(tmp_path: Path) -> None:
    catalog, random = definitions(tmp_path), Random(2)
    types = {name: catalog.message(name) for name in catalog.message_names()}
    services = {name: catalog.service(name) for name in catalog.service_names()}
    messages = {name: type_ for name, type_ in types.items() if type_}
    payloads = {
        name: [type_.encode(random_message(random, type_.layout)).hex() for _ in range(4)]
        for name, type_ in messages.items()
    }
    assert len(messages) > 170
    answer = answer_of_ros({
        "messages": {name: type_.definition for name, type_ in messages.items()},
        "services": {
            name: f"{each.request.definition}---\n{each.response.definition}" for name, each in services.items() if each
        },
        "payloads": {name: (type_.full_definition, payloads[name]) for name, type_ in messages.items()},
    }, tmp_path)  # fmt: skip
    sums = {name: type_.md5 for name, type_ in messages.items()}
    for name, service in services.items():
        assert service is not None
        sums |= {name: service.md5, f"{name}Request": service.request.md5, f"{name}Response": service.response.md5}
    assert answer["md5"] == sums
    assert answer["generated"] == {
        name: {"md5": type_.md5, "payloads": payloads[name]} for name, type_ in messages.items()
    }
