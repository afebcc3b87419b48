"""Run the command line interface: `python -m hostlink`."""

from hostlink.cli.start import main

if __name__ == "__main__":
    main()
