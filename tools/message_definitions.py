"""Write hostlink/core/messages/noetic.txt: the definitions of ROS 1 Noetic's message types, from rosbags.

python -m tools.message_definitions --write; without it, ends with status 1 when the file differs. The file spares an
installation rosbags and its 16 MB. `tests/unit/core/messages/test_catalog.py` compares md5 sums with rosbags.
"""

import sys

from rosbags.typesys import Stores, get_typestore

from hostlink.core.messages.catalog import STANDARD
from hostlink.core.messages.message_type import SEPARATOR


def definitions() -> str:
    """Return the text of the file: for each type a line of =, its name, and its definition without nested types."""
    store = get_typestore(Stores.ROS1_NOETIC)
    parts = []
    for name in sorted(store.fielddefs):
        if not name.startswith("builtin_interfaces/"):
            text = store.generate_msgdef(name, ros_version=1)[0].partition(SEPARATOR)[0].strip("\n")
            lines = [SEPARATOR, f"MSG: {name.replace('/msg/', '/')}", *([text] if text else [])]
            parts.append("\n".join(lines) + "\n")
    return "".join(parts)


def main(arguments: list[str]) -> int:
    if arguments == ["--write"]:
        STANDARD.write_text(definitions(), encoding="utf-8")
    elif STANDARD.read_text(encoding="utf-8") != definitions():
        sys.stderr.write(f"{STANDARD.name} is not what rosbags has: run  python -m tools.message_definitions --write\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
