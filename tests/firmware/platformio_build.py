"""PlatformIO's result for the sketch in the present folder: the last printed line is JSON.

    python -m tests.firmware.platformio_build ENV

PlatformIO's own functions, without one of its platforms: they run inside of SCons, in a process of their own.
"""

import json
import sys
from pathlib import Path

from platformio.builder.tools import piobuild, pioino
from platformio.project.config import ProjectConfig
from SCons.Environment import Environment


def main(name: str) -> None:
    config = ProjectConfig.get_instance("platformio.ini")
    config.validate(envs=[name])
    build = Environment(tools=[], PROJECT_SRC_DIR=config.get("platformio", "src_dir"), CXX="g++")
    for tool in (pioino, piobuild):
        tool.generate(build)
    build.AddMethod(lambda _, action, __: action, "VerboseAction")
    sketches = [node.get_path() for node in build.FindInoNodes()]
    build.ConvertInoToCpp()
    wanted = config.get(f"env:{name}", "build_src_filter")
    sources = sorted(build.MatchSourceFiles("$PROJECT_SRC_DIR", wanted, piobuild.SRC_BUILD_EXT))
    converted = {path: Path(path).read_text() for path in sources if path.endswith(".ino.cpp")}
    json.dump({"sketches": sketches, "sources": sources, "converted": converted}, sys.stdout)


if __name__ == "__main__":
    main(sys.argv[1])
