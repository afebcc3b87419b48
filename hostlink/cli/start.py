"""Entry point of the program `hostlink`. While it imports, Ctrl-C ends it without a traceback."""

import importlib
import signal


def main() -> None:
    """Import the command line and run it."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # else the parent process ignores the signal
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    importlib.import_module("hostlink.cli.main").main()
