"""The program `hostlink`: until its command runs, Ctrl-C ends it as any signal does, without a traceback of imports."""

import importlib
import signal


def main() -> None:
    """Import the command line and run it."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # else whoever started it ignores the signal
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    importlib.import_module("hostlink.cli.main").main()
