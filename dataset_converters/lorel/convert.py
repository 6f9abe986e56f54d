"""Original LOReL files as LeRobot datasets, in one pass and bounded memory."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from dataset_converters.card import write_card
from dataset_converters.lorel.cards import converted_card
from dataset_converters.lorel.episode import LorelEpisode, is_labelled
from dataset_converters.lorel.labels_csv import read_labels
from dataset_converters.lorel.original_file import OriginalFile, open_original
from dataset_converters.lorel.schema import lorel_layout, to_episodes
from dataset_converters.staging import staged
from dataset_converters.workers import progress
from dataset_converters.writer import DatasetTotals, write_dataset
from lerobot_lisa.errors import UserError


@dataclass(frozen=True)
class ConvertSettings:
    """What to convert, and which part of it.

    Attributes:
        source: HDF5 file.
        labels: CSV file.
        root: directory to create.
        repo_id: name of the dataset.
        images: whether to convert the images too.
        limit: number of episodes of the file to look at; None: all.
        keep_unlabelled: keep episodes whose label says that nothing happened.
    """

    source: Path
    labels: Path
    root: Path
    repo_id: str
    images: bool = False
    limit: int | None = None
    keep_unlabelled: bool = False


@dataclass(frozen=True)
class ConvertResult:
    """What was converted."""

    totals: DatasetTotals
    dropped: int  # episodes whose label says that nothing happened


def convert(settings: ConvertSettings) -> ConvertResult:
    """Convert one original pair of files; episodes keep the order of the file and remember their index in it.

    Raises:
        UserError: for anything wrong with the files, the selection or the output; nothing is left behind then.
    """
    described = {key: str(value) for key, value in vars(settings).items()}
    labels = read_labels(settings.labels)
    with open_original(settings.source, settings.images) as file:
        count = _count(settings, file, labels)
        chosen = [settings.keep_unlabelled or is_labelled(label) for label in labels[:count]]
        dropped = count - sum(chosen)
        if dropped == count:
            raise UserError(
                f"{settings.labels}: no label says that anything happened; --keep-unlabelled keeps them all"
            )
        with staged(settings.root, described) as partial:
            layout = lorel_layout(settings.repo_id, file.image_quality)
            episodes = (episode for episode in _episodes(file, labels, count) if chosen[episode.source_index or 0])
            with progress(episodes, sum(chosen), "converting") as bar:
                totals = write_dataset(partial / "dataset", layout, to_episodes(bar))
            selection = "all episodes" if settings.limit is None else f"its first {count:,} episodes"
            card = converted_card(settings.source, selection, file.image_quality, dropped)
            write_card(partial / "dataset", settings.repo_id, card)
    return ConvertResult(totals, dropped)


def _count(settings: ConvertSettings, file: OriginalFile, labels: Sequence[str]) -> int:
    if len(labels) != file.episodes:
        raise UserError(
            f"{settings.labels}: has {len(labels)} labels, but {settings.source} has {file.episodes} episodes; "
            "do they belong together?"
        )
    if settings.limit is None:
        return file.episodes
    if not 1 <= settings.limit <= file.episodes:
        raise UserError(f"{settings.source}: --limit {settings.limit} must be 1 to {file.episodes}, its episodes")
    return settings.limit


def _episodes(file: OriginalFile, labels: Sequence[str], count: int) -> Iterator[LorelEpisode]:
    for block in file.blocks(count):
        for i in range(len(block.state)):
            index = block.first + i
            images = None if block.images is None else block.images[i]
            yield LorelEpisode(labels[index], block.state[i], block.action[i], images, source_index=index)
