"""`python -m dataset_converters.babyai`: see `cli`. Worker processes import this file, so it imports nothing early."""

if __name__ == "__main__":
    import sys

    from dataset_converters.babyai.cli import main

    sys.exit(main())
