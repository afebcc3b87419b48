"""Import each compiled module of the hostlink that this Python finds, and tell whether the extension is what runs.

python3 tools/try_compiled.py, with the Python of an installation. Ends with status 1 for the pure wheel, or when a
module is imported from its source although its extension exists. It needs only Python, like try_drive.py.
"""

import importlib
import platform
import sys
from pathlib import Path

import hostlink


def main() -> int:
    package = Path(str(hostlink.__file__)).parent
    extensions = sorted(package.rglob("*.so"))
    modules = [
        importlib.import_module(
            ".".join(("hostlink", *path.parent.relative_to(package).parts, path.name.split(".")[0]))
        )
        for path in extensions
    ]
    sources = [module.__name__ for module in modules if not str(module.__file__).endswith(".so")]
    print(f"{len(modules)} compiled modules in {package}, {platform.machine()}, Python {platform.python_version()}")
    if sources:
        print(f"imported from their sources: {', '.join(sources)}")
    return 0 if modules and not sources else 1


if __name__ == "__main__":
    sys.exit(main())
