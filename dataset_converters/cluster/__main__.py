"""`python -m dataset_converters.cluster`: see `cli`. Worker processes import this file, so it imports nothing early."""

if __name__ == "__main__":
    import sys

    from dataset_converters.cluster.cli import main

    sys.exit(main())
