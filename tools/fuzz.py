"""Coverage-guided fuzzing of the readers of foreign bytes, for a bounded time; part of `make fuzz`.

By atheris; the generated headers of the board library ("headers") by clang's libFuzzer.

Each target starts from tests/corpus/TARGET and from what earlier runs on this machine have learned (build/fuzz/TARGET/
corpus). What breaks a law is written to build/fuzz/TARGET, and is added to tests/corpus with the fix; of
"headers", whose inputs number the types, to tests/property/test_board_headers.py.
"""

import argparse
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

CORPUS = ROOT / "tests" / "corpus"
FOUND = ROOT / "build" / "fuzz"
MAX_BYTES = 512
HEADERS = "headers"
NAMES = ("stream", "session", "control", "codec", "cdr", HEADERS)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=int, default=60, help="for each target (%(default)s)")
    parser.add_argument("--target", choices=NAMES, action="append", help="only this one; may be repeated")
    parser.add_argument("--run", nargs=argparse.REMAINDER, help=argparse.SUPPRESS)  # this program, in a child
    arguments = parser.parse_args()
    if arguments.run:
        name, *options = arguments.run
        fuzz(name, options)
        return 0
    return max(fuzz_in_process(name, arguments.seconds) for name in arguments.target or NAMES)


def fuzz_in_process(name: str, seconds: int) -> int:
    """Fuzz one target in a process of its own: libFuzzer ends its process. Returns the status."""
    found, corpus = FOUND / name, CORPUS / name
    work = found / "corpus"
    work.mkdir(parents=True, exist_ok=True)
    corpus.mkdir(parents=True, exist_ok=True)
    print(f"{name}: {seconds} s from {len(list(corpus.iterdir()))} inputs", flush=True)
    limits = [f"-max_total_time={seconds}", f"-max_len={MAX_BYTES}", "-timeout=10", "-rss_limit_mb=2048"]
    options = [*limits, f"-artifact_prefix={found}/", "-print_final_stats=1", str(work), str(corpus)]
    program = [sys.executable, __file__, "--run", name]
    if name == HEADERS:
        from tests.support.headers_fuzzer import compile_fuzzer  # noqa: PLC0415 - the others need no hostlink here

        built = compile_fuzzer(found / "built")
        program = [str(built)]
        options.append(str(built.parent / "seeds"))
    return subprocess.run([*program, *options], cwd=ROOT, check=False).returncode


def fuzz(name: str, options: list[str]) -> None:
    """Never returns."""
    try:
        import atheris  # noqa: PLC0415 - only here, and only with the extra `fuzz`
    except ImportError as error:
        sys.exit(f"atheris has no wheel for this Python, or is not installed (pip install -e '.[fuzz]'): {error}")
    with atheris.instrument_imports(include=["hostlink.core.protocol", "hostlink.core.messages"]):
        from tests.support.fuzz_targets import TARGETS  # noqa: PLC0415 - after the instrumentation
    atheris.Setup([sys.argv[0], *options], TARGETS[name])
    atheris.Fuzz()


if __name__ == "__main__":
    sys.exit(main())
