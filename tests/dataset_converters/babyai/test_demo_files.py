"""Original files are read exactly, and hostile ones neither run, nor change anything, nor take memory."""

import functools
import operator
import os
import pickle
import struct
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from original_files import demo, dump, gym_minigrid, pack

from dataset_converters.babyai import pickle_parts, pickle_reader
from dataset_converters.babyai.demo_files import count_demonstrations, level_from_name, read_demonstrations
from dataset_converters.babyai.encodings import CellEncoding
from lerobot_lisa.errors import UserError

REAL = Path(__file__).parents[4] / "shared/data/babyai/BabyAI-GoToSeq-v0_valid.pkl"


def read(tmp_path: Path, content: bytes, **options) -> list:
    path = tmp_path / "BabyAI-GoTo-v0.pkl"
    path.write_bytes(content)
    return list(read_demonstrations(path, "GoTo", **options))


def refused(tmp_path: Path, content: bytes, match: str | None = None) -> None:
    with pytest.raises(UserError, match=match) as caught:
        read(tmp_path, content)
    assert "\n" not in str(caught.value)
    assert "BabyAI-GoTo-v0.pkl" in str(caught.value)


def assert_read(demos, got) -> None:
    assert len(got) == len(demos)
    for (mission, images, directions, actions), demonstration in zip(demos, got, strict=True):
        assert demonstration.instruction == mission
        assert np.array_equal(demonstration.grid, images.reshape(len(actions), 147))
        assert demonstration.direction.tolist() == directions
        assert demonstration.action.tolist() == actions


@pytest.mark.parametrize("protocol", range(6))
@pytest.mark.parametrize("kind", ["int", "enum", "getattr", "numpy"])
def test_every_protocol_and_every_spelling_of_an_action(tmp_path, protocol, kind):
    demos = [demo(length, seed=length) for length in (1, 7, 300)]
    with gym_minigrid() as actions:
        if kind == "getattr":  # as enumerations of Python 3.11 did
            actions.__reduce_ex__ = lambda self, _: (getattr, (type(self), self.name))
        make = {"int": int, "enum": actions, "getattr": actions, "numpy": np.int64}[kind]
        content = dump(demos, protocol, make)
    assert_read(demos, read(tmp_path, content))


def test_more_demonstrations_than_one_block_of_the_pickler(tmp_path):
    demos = [demo(2, seed=i, mission=f"go to ball {i}") for i in range(2100)]
    assert_read(demos, read(tmp_path, dump(demos)))
    assert count_demonstrations(tmp_path / "BabyAI-GoTo-v0.pkl") == 2100


@pytest.mark.parametrize("protocol", [2, 3, 4])
def test_payloads_of_numpy_1_are_read(tmp_path, protocol):
    item = demo(5)
    old = pickle.dumps(item[1], protocol).replace(b"numpy._core", b"numpy.core")
    if protocol == 4:
        old = old.replace(b"\x8c\x16numpy.core", b"\x8c\x15numpy.core")
    assert b"numpy.core.multiarray" in old
    content = pickle.dumps([(item[0], pack(item[1], payload=old), item[2], item[3])], 4)
    assert_read([item], read(tmp_path, content))


def test_a_python_2_file_is_read(tmp_path):
    mission, images, directions, actions = demo(3)
    packed = pack(images)
    ints = [b"(" + b"".join(b"K" + bytes([v]) for v in values) + b"e" for values in (directions, actions)]
    content = b"\x80\x02](" + b"(U" + bytes([len(mission)]) + mission.encode() + b"T" + struct.pack("<I", len(packed))
    content += packed + b"]" + ints[0] + b"]" + ints[1] + b"te."
    assert_read([(mission, images, directions, actions)], read(tmp_path, content))


def test_the_real_file_reads_as_the_original_package_read_it():
    if not REAL.exists():
        pytest.skip(f"{REAL.name} is not here")
    import blosc

    got = list(read_demonstrations(REAL, "GoToSeq"))
    with gym_minigrid():
        original = pickle.loads(REAL.read_bytes())
    demos = [(m, blosc.unpack_array(packed), list(map(int, d)), list(map(int, a))) for m, packed, d, a in original]
    assert len(got) == 50
    assert_read(demos, got)


# --- hostile files ----------------------------------------------------------------------------------------------------


class Calls:
    """Pickles as a call of `function` with `arguments`."""

    def __init__(self, function, *arguments):
        self.call = (function, arguments)

    def __reduce__(self):
        return self.call


def attacks(mark: Path) -> dict[str, object]:
    command = f"touch {mark}"
    return {
        "os.system": Calls(os.system, command),
        "eval": Calls(eval, f"open({str(mark)!r}, 'w')"),
        "exec": Calls(exec, f"open({str(mark)!r}, 'w')"),
        "import": Calls(__import__, "antigravity"),
        "getattr of os": Calls(getattr, Calls(__import__, "os"), "system"),
        "partial": Calls(functools.partial, os.system, command),
        "attrgetter": Calls(operator.attrgetter("system"), Calls(__import__, "os")),
        "attrgetter itself": Calls(operator.attrgetter, "system"),
        "np.load": Calls(np.load, str(mark)),
        "np.save": Calls(np.save, str(mark), 1),
        "object array": np.array([Calls(os.system, command)], dtype=object),
        "structured array": np.zeros(3, [("a", "u1")]),
        "open": Calls(open, str(mark), "w"),
        "bytearray": Calls(bytearray, 10**9),
        "range list": Calls(list, range(3)),
    }


@pytest.mark.parametrize("name", attacks(Path("x")))
@pytest.mark.parametrize("protocol", [0, 2, 4, 5])
def test_nothing_in_a_file_runs(tmp_path, name, protocol):
    mark = tmp_path / "executed"
    attack = attacks(mark)[name]
    mission, images, directions, actions = demo(3)
    inner = pickle.dumps(attack, protocol)
    for content in (
        inner,
        pickle.dumps([attack], protocol),
        pickle.dumps([(attack, pack(images), directions, actions)], protocol),
        pickle.dumps([(mission, attack, directions, actions)], protocol),
        pickle.dumps([(mission, pack(images), [attack], actions)], protocol),
        pickle.dumps([(mission, pack(images), directions, [attack])], protocol),
        pickle.dumps([(mission, pack(images, payload=inner), directions, actions)], 4),
    ):
        refused(tmp_path, content)
    assert not mark.exists()


def _text(text: str) -> bytes:
    return b"\x8c" + bytes([len(text)]) + text.encode()


@pytest.mark.parametrize("module_and_name", sorted(pickle_parts.DEMO_PARTS))
@pytest.mark.parametrize("state", [b"}", b"N", b")", b"}" + _text("a") + b"K\x01s", b"N}" + _text("a") + b"K\x01s\x86"])
def test_no_known_name_can_be_changed_through_build(tmp_path, module_and_name, state):
    module, name = module_and_name
    part = pickle_parts.DEMO_PARTS[module_and_name]
    before = {field: getattr(part, field) for field in pickle_reader.Part._fields}
    refused(tmp_path, b"\x80\x04](" + _text(module) + _text(name) + b"\x93" + state + b"be.")
    refused(tmp_path, b"\x80\x04](" + _text(module) + _text(name) + b"\x93)R" + state + b"be.")
    assert pickle_parts.DEMO_PARTS[module_and_name] is part
    assert {field: getattr(part, field) for field in pickle_reader.Part._fields} == before


BOMBS = {
    "laughs": b"\x80\x04]((K\x01K\x01t" + b"".join(b"q%c(%st" % (i, b"h%c" % i * 10) for i in range(9)) + b"e.",
    "duplicates": b"\x80\x04](K\x01" + b"2\x86" * 5000 + b"e.",
    "nested tuples": b"\x80\x04](" + b")" + b"\x85" * 2_000_000 + b"e.",
    "nested lists": b"\x80\x04" + b"](" * 2_000_000 + b"e" * 2_000_000 + b".",
    "empty lists": b"\x80\x04](" + b"]" * 2_000_000 + b"e.",
    "marks": b"\x80\x04]" + b"(" * 2_000_000 + b".",
    "long text": b"\x80\x04](\x8d" + struct.pack("<Q", 2**62) + b"e.",
    "long bytes": b"\x80\x04](\x8e" + struct.pack("<Q", 2**40) + b"e.",
    "bytearray": b"\x80\x05](\x96" + struct.pack("<Q", 2**40) + b"e.",
    "frame": b"\x80\x04\x95" + b"\xff" * 8 + b"](\x8e" + b"\xff" * 8 + b"e.",
    "digits": b"(lp0\nI" + b"9" * 2_000_000 + b"\na.",
    "long integer": b"\x80\x04](\x8b" + struct.pack("<i", 2**31 - 1) + b"e.",
    "many integers": b"\x80\x04]((U\x01aU\x01b](" + b"K\x01" * 1_000_000 + b"e](e t e.",
    "texts": b"\x80\x04](" + b"\x8c\x02go" * 500_000 + b"e.",
    "remembered numbers": b"\x80\x02](" + b"".join(b"K\x01r" + struct.pack("<I", i) for i in range(300_000)) + b"e.",
    "memo index": b"\x80\x02](r\xff\xff\xff\xff" + b"K\x01r\xff\xff\xff\xffe.",
}


@pytest.mark.parametrize("name", BOMBS)
def test_small_files_cannot_take_much_memory(tmp_path, name):
    tracemalloc.start()
    try:
        refused(tmp_path, BOMBS[name])
        assert tracemalloc.get_traced_memory()[1] < 40_000_000
    finally:
        tracemalloc.stop()


def test_a_file_is_never_held_as_a_whole():
    rng = np.random.default_rng(0)
    content = pickle.dumps([(f"go to ball {i}", rng.bytes(5000), [0, 1], [1, 2]) for i in range(3000)], 4)
    assert len(content) > 15_000_000
    tracemalloc.start()
    try:
        assert sum(1 for _ in pickle_reader.read_items(content, pickle_parts.DEMO_PARTS)) == 3000
        assert tracemalloc.get_traced_memory()[1] < 2_000_000
    finally:
        tracemalloc.stop()


def test_a_blosc_buffer_may_not_unpack_to_more_than_its_episode(tmp_path):
    mission, images, directions, actions = demo(3)
    bomb = pack(images, payload=pickle.dumps(np.zeros((100_000, 7, 7, 3), np.uint8), 4))
    assert len(bomb) < 200_000
    refused(tmp_path, pickle.dumps([(mission, bomb, directions, actions)], 4), "claim 14,700,1")
    lying = bytearray(pack(images))
    lying[4:8] = struct.pack("<I", 10)  # the header promises less than the buffer holds
    refused(tmp_path, pickle.dumps([(mission, bytes(lying), directions, actions)], 4))


@pytest.mark.parametrize("cut", [0, 1, 2, 30, 400, -300, -2, -1])
def test_truncated_and_empty_files(tmp_path, cut):
    content = dump([demo(4), demo(6)])
    refused(tmp_path, content[:cut], "empty|too early|truncated|damaged|no demonstrations")


def test_random_damage_never_escapes_as_another_error(tmp_path):
    content = dump([demo(9, seed=i) for i in range(3)])
    rng = np.random.default_rng(0)
    for _ in range(1500):
        damaged = bytearray(content)
        for place in rng.integers(0, len(content), rng.integers(1, 4)):
            damaged[place] = rng.integers(0, 256)
        try:
            read(tmp_path, bytes(damaged))
        except UserError as error:
            assert "\n" not in str(error)  # noqa: PT017


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (pickle.dumps([]), "no demonstrations"),
        (pickle.dumps({"a": 1}), "does not need"),
        (pickle.dumps("text"), "expected a list"),
        (pickle.dumps([("go", b"x", [0], [0])]), "blosc buffer"),
        (pickle.dumps([("go", pack(demo(2)[1]), [0], [0, 1])]), "directions and actions differ"),
        (pickle.dumps([("go", pack(demo(3)[1]), [0, 1], [0, 1])]), "one for each action"),
        (pickle.dumps([("go", pack(demo(2)[1]), [0, 1], [0, 7])]), "action is outside 0..6"),
        (pickle.dumps([("go", pack(demo(2)[1]), [0, 4], [0, 1])]), "direction is outside 0..3"),
        (pickle.dumps([("go", pack(demo(2)[1]), [0, 1], [0, -1])]), "action is outside"),
        (pickle.dumps([(b"go", pack(demo(2)[1]), [0, 1], [0, 1])]), "instruction"),
        (pickle.dumps([("go", pack(demo(2)[1].astype(np.int64)), [0, 1], [0, 1])]), "not uint8"),
        (dump([demo(2), ("", *demo(2)[1:])]), "demonstration 1: the instruction"),
        (dump([demo(2), ("go\n# heading", *demo(2)[1:])]), "demonstration 1: the instruction .* control characters"),
        (dump([demo(2), ("x" * 100_000, *demo(2)[1:])]), "demonstration 1: the instruction has 100,000 characters"),
        (pickle.dumps([("go", pack(demo(2)[1]), [0, 1], [0, float("inf")])]), "BabyAI-GoTo-v0.pkl"),
    ],
)
def test_what_is_wrong_is_said(tmp_path, content, message):
    refused(tmp_path, content, message)


def test_a_missing_file_and_level_names(tmp_path):
    with pytest.raises(UserError, match=r"nowhere\.pkl: cannot be read"):
        list(read_demonstrations(tmp_path / "nowhere.pkl", "GoTo"))
    assert level_from_name(Path("a/BabyAI-GoToSeq-v0_valid.pkl")) == "GoToSeq"
    assert level_from_name(Path("BabyAI-BossLevel-v0.pkl")) == "BossLevel"
    assert level_from_name(Path("demos.pkl")) is None


# --- cell encodings ---------------------------------------------------------------------------------------------------

CELLS = {  # what is seen -> its cell today, in B (until January 2019) and in A (until November 2018)
    "unseen": ((0, 0, 0), (0, 0, 0), (0, 0, 0)),
    "empty": ((1, 0, 0), (1, 0, 0), (0, 0, 0)),
    "wall": ((2, 5, 0), (2, 5, 0), (1, 5, 0)),
    "open door": ((4, 1, 0), (4, 1, 1), (3, 1, 1)),
    "closed door": ((4, 2, 1), (4, 2, 0), (3, 2, 0)),
    "locked door": ((4, 3, 2), (5, 3, 0), (4, 3, 0)),
    "key": ((5, 4, 0), (6, 4, 0), (5, 4, 0)),
    "ball": ((6, 0, 0), (7, 0, 0), (6, 0, 0)),
    "box": ((7, 1, 0), (8, 1, 0), (7, 1, 0)),
}


def views(encoding: int, *objects: str) -> np.ndarray:
    """(1, 7, 7, 3): walls, and objects in a room of empty cells; doors stand in the wall."""
    grid = np.empty((1, 7, 7, 3), np.uint8)
    grid[:] = CELLS["empty"][encoding]
    grid[:, :, 0] = CELLS["wall"][encoding]
    for i, name in enumerate(objects):
        grid[0, 1 + i, 0 if "door" in name else 3] = CELLS[name][encoding]
    return grid


def encoded_file(encoding: int, *objects: str) -> bytes:
    return dump([demo(1, images=views(encoding, *objects))])


EVERYTHING = ("unseen", "open door", "closed door", "locked door", "key", "ball", "box")


def test_old_cells_are_rewritten_as_minigrids(tmp_path):
    today = read(tmp_path, encoded_file(0, *EVERYTHING[1:]))[0].grid
    old = read(tmp_path, encoded_file(1, *EVERYTHING[1:]))[0].grid
    assert np.array_equal(today, views(0, *EVERYTHING[1:]).reshape(1, 147))
    assert np.array_equal(old, today)


@pytest.mark.parametrize("objects", [("key",), ("locked door",), ("key", "box"), ("open door", "key", "ball", "box")])
def test_todays_encoding_is_recognised(tmp_path, objects):
    got = read(tmp_path, encoded_file(0, *objects))
    assert np.array_equal(got[0].grid, views(0, *objects).reshape(1, 147))


def test_an_encoding_that_cannot_be_told_or_rewritten_is_refused(tmp_path):
    refused(tmp_path, encoded_file(2, "ball"), "before November 2018")
    refused(tmp_path, encoded_file(0, "ball"), "--cell-encoding")
    refused(tmp_path, dump([demo(1, images=views(0, "key")), demo(1, images=views(1, "box"))]), "different")
    assert read(tmp_path, encoded_file(0, "ball"), encoding=CellEncoding.MINIGRID)[0].grid.max() == 6
    old = read(tmp_path, encoded_file(1, "ball"), encoding=CellEncoding.B)
    assert np.array_equal(old[0].grid, views(0, "ball").reshape(1, 147))
    with pytest.raises(UserError, match="do not exist"):
        read(tmp_path, encoded_file(1, "box"), encoding=CellEncoding.MINIGRID)
