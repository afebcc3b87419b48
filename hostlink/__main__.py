"""`python -m hostlink` is `hostlink`."""

from hostlink.cli.start import main

if __name__ == "__main__":
    main()
