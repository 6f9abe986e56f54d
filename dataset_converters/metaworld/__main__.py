"""`python -m dataset_converters.metaworld`: see `cli`. Worker processes import this file: nothing is imported early."""

if __name__ == "__main__":
    import sys

    from dataset_converters.metaworld.cli import main

    sys.exit(main())
