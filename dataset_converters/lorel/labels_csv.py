"""Labels of the original data set: one row of a CSV file for each episode, in the order of the HDF5 file."""

import csv
from collections.abc import Iterable, Iterator
from pathlib import Path

from dataset_converters.instructions import check_instruction
from lerobot_lisa.errors import UserError

COLUMNS = ("Episode Number", "Text Description")


def read_labels(path: Path) -> list[str]:
    """Read all labels, without the blanks around them.

    Raises:
        UserError: if the file cannot be read, is not UTF-8 or has other columns; if a row is not numbered as its place
            says, or its label is empty or not one line of text.
    """
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            return list(_labels(path, csv.reader(file, strict=True)))
    except UnicodeDecodeError as error:
        raise UserError(f"{path}: is not UTF-8 text (byte {error.start} of a block); save it as UTF-8") from error
    except csv.Error as error:
        raise UserError(f"{path}: is not a CSV file ({error}); is it damaged?") from error
    except OSError as error:
        raise UserError(f"{path}: {error.strerror or error}; give the CSV file of labels") from error


def _labels(path: Path, rows: Iterator[list[str]]) -> Iterator[str]:
    header = [name.strip() for name in next(rows, [])]
    missing = [name for name in COLUMNS if name not in header]
    if missing:
        raise UserError(f"{path}: its first line has no column {missing[0]!r}; the columns are {', '.join(COLUMNS)}")
    number, text = (header.index(name) for name in COLUMNS)
    for index, row in enumerate(rows):
        if len(row) != len(header):
            raise UserError(f"{path}: row {index + 1} has {len(row)} fields instead of {len(header)}; is it damaged?")
        if row[number].strip() != str(index):
            fix = "sort its rows" if index else "is it a part of a longer file? Number its episodes from 0"
            raise UserError(f"{path}: row {index + 1} is numbered {row[number][:40]!r} instead of {index}; {fix}")
        label = row[text].strip()
        check_instruction(label, f"{path}: the label of episode {index}")
        yield label


def write_labels(path: Path, labels: Iterable[str]) -> None:
    """Write labels in the layout of the original data set."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        writer.writerows(enumerate(labels))
