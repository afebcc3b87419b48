"""`python -m hostlink` is `hostlink`."""

from hostlink.cli.main import main

if __name__ == "__main__":
    main()
