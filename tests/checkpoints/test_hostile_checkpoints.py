"""Checkpoints made to harm: each is refused in one line that names the file, and nothing in them is run."""

import json
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from checkpoint_copy import Copy
from safetensors.torch import load_file, save_file

from lerobot_lisa.checkpoints.load import load_checkpoint, load_config
from lerobot_lisa.errors import UserError

CONFIG, BEFORE, AFTER = "config.json", "policy_preprocessor.json", "policy_postprocessor.json"
READS = "this reads checkpoints of babyai_rnn, kmeans_skills, lang_bc, lang_dt, lisa, lorel_planner"
TOKENIZER = "policy_preprocessor_step_2_lisa_instructions.safetensors"
Change = Callable[[Any], object]


def refused(copy: Copy, monkeypatch: pytest.MonkeyPatch) -> str:
    """Load it, as every analysis command does; returns the line."""
    monkeypatch.chdir(copy.folder.parent)  # programs that are run leave their traces here
    before = {path.name for path in copy.folder.parent.iterdir()}
    with pytest.raises(UserError) as told:
        load_checkpoint(load_config(str(copy.folder)))
    assert {path.name for path in copy.folder.parent.iterdir()} == before
    line = str(told.value)
    assert "\n" not in line
    assert len(line) < 1000
    return line


def settings(**changed: Any) -> Change:
    return lambda content: content.update(changed)


def step(name: str, change: Change) -> Change:
    """Change one step of a pipeline."""
    return lambda content: change(next(s for s in content["steps"] if name in s["registry_name"]))


def configured(name: str, **changed: Any) -> Change:
    """Change settings of one step of a pipeline."""
    return step(name, lambda found: found["config"].update(changed))


RUN_A_PROGRAM = {"class": "subprocess.Popen", "config": {"args": ["touch", "pwned"]}}
BERT = {"model_type": "bert", "hidden_size": 16, "num_attention_heads": 2, "num_hidden_layers": 1, "vocab_size": 30}


@pytest.mark.parametrize(
    ("file", "change", "line"),
    [
        (CONFIG, settings(type="os.system"), f"is a os.system policy: {READS}"),
        (CONFIG, settings(type=["lisa"]), READS),
        (CONFIG, lambda content: content.pop("type"), "is a None policy"),
        (CONFIG, settings(input_features=None), r"config\.json names no input_features"),
        (CONFIG, settings(output_features={}), r"config\.json names no output_features"),
        (CONFIG, settings(nobody_knows=1), r"config\.json cannot be used .*nobody_knows"),
        (CONFIG, settings(device="/dev/sda"), r"config\.json: .*/dev/sda"),
        (CONFIG, settings(dropout=float("nan")), r"config\.json is not JSON .*NaN is no number"),
        (CONFIG, settings(use_peft=True), r"config\.json is an adapter's"),
        (CONFIG, settings(codebook_size=10**8), r"config\.json: .*codebook_size=100000000 must be between"),
        (CONFIG, settings(action_classes=10**9), r"config\.json: .*action_classes"),
        (CONFIG, settings(max_timesteps=10**9), r"config\.json: .*max_timesteps"),
        (CONFIG, settings(max_timesteps=-5), r"config\.json: .*max_timesteps"),
        (CONFIG, settings(action_temperature=1e-300), "cannot act|action_temperature"),
        (CONFIG, settings(n_predictor_layers=-1), r"config\.json: .*n_predictor_layers"),
        (CONFIG, settings(n_heads=-2), r"config\.json: .*n_heads"),
        (CONFIG, settings(skill_plan="9" * 5000), "plan|config"),
        (CONFIG, settings(skill_plan=",".join(["0*1"] * 10**6)), "bytes, more than"),
        (CONFIG, settings(vocabulary=["[PAD]", "a"]), "language encoder knows 4"),
        (CONFIG, settings(normalization_mapping={"STATE": "../x"}), r"config\.json cannot be used .*normalization"),
        (
            CONFIG,
            lambda content: content["input_features"]["observation.grid"].update(shape=[-147]),
            "observation.grid|preprocessor",
        ),
        (CONFIG, lambda made: made["input_features"]["observation.grid"].update(shape=[10**12]), "grid|parameters"),
        (CONFIG, settings(language_encoder="/etc", language_model=None), r"config\.json does not describe its pre"),
        (CONFIG, settings(language_encoder="x", language_model={"model_type": "os.system"}), "no encoder can be"),
        (CONFIG, settings(language_encoder="x", language_model={"hidden_size": 8}), "no encoder can be"),
        (CONFIG, settings(language_encoder="x", language_model={**BERT, "hidden_size": 10**7}), "hidden_size is 10000"),
        (CONFIG, settings(language_encoder="x", language_model={**BERT, "num_hidden_layers": 500}), "_layers is 500"),
        (CONFIG, settings(language_encoder="x", language_model={**BERT, "auto_map": {"AutoModel": "a.B"}}), "auto_map"),
        (CONFIG, settings(language_encoder="x", language_model={"model_type": "timm_wrapper"}), "fetch their weights"),
        (BEFORE, lambda content: content["steps"].insert(0, RUN_A_PROGRAM), "asks for the class 'subprocess.Popen'"),
        (AFTER, lambda content: content["steps"].append(RUN_A_PROGRAM), "asks for the class 'subprocess.Popen'"),
        (BEFORE, step("to_batch", lambda found: found.update(RUN_A_PROGRAM)), "asks for the class 'subprocess.Popen'"),
        (BEFORE, lambda content: content["steps"].insert(0, ["touch", "pwned"]), "asks for the class"),
        (BEFORE, lambda content: content["steps"].insert(0, {"registry_name": "tokenizer_processor"}), "has the steps"),
        (BEFORE, lambda content: content["steps"].pop(2), "has the steps"),
        (BEFORE, lambda content: content["steps"].reverse(), "has the steps"),
        (BEFORE, settings(steps={}), "where a pipeline has name and steps"),
        (BEFORE, settings(hooks=["os"]), "where a pipeline has name and steps"),
        (BEFORE, step("lisa", lambda found: found.pop("state_file")), r"has lost its tokenizer \(state_file\)"),
        (BEFORE, step("lisa", settings(hook="os")), "which this does not know"),
        (BEFORE, configured("lisa", tokenizer="x"), "knows the settings"),
        (BEFORE, step("to_batch", settings(state_file="model.safetensors")), "has no tensors, but names the file"),
        (BEFORE, step("lisa", settings(state_file=7)), "has no tensors, but names the file 7"),
        (BEFORE, step("lisa", settings(state_file="../other.safetensors")), "beside it are read"),
        (BEFORE, step("lisa", settings(state_file="/etc/passwd")), "beside it are read"),
        (BEFORE, step("lisa", settings(state_file="README.md")), "beside it are read"),
        (BEFORE, step("lisa", settings(state_file="absent.safetensors")), r"absent\.safetensors is missing"),
        (BEFORE, step("lisa", settings(state_file="model.safetensors")), "where the bytes of a tokenizer belong"),
        (BEFORE, configured("rename", rename_map=["x"]), "rename_map is no map of names"),
        (
            BEFORE,
            configured("rename", rename_map={"observation.grid": "observation.direction"}),
            r"gives the policy no finite observation\.grid",
        ),
        (BEFORE, configured("device", float_dtype="evil"), "cannot be used .*evil"),
        (BEFORE, configured("normalizer", norm_map={"ENV": "../x"}), "cannot be used"),
        (BEFORE, configured("normalizer", features={"observation.grid": "x"}), "cannot be used"),
        (AFTER, configured("unnormalizer", norm_map=[1]), "cannot be used"),
    ],
)  # fmt: skip
def test_json(copy: Copy, file: str, change: Change, line: str, monkeypatch: pytest.MonkeyPatch) -> None:
    copy.edit(file, change)
    assert re.search(line, refused(copy, monkeypatch))


@pytest.mark.parametrize("file", [CONFIG, BEFORE, AFTER])
@pytest.mark.parametrize("content", [b"", b"{", b"[]", b"\xff\xfe", b'{"a":' * 500 + b"1" + b"}" * 500, b" " * 2**22])
def test_no_json(copy: Copy, file: str, content: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    (copy.folder / file).write_bytes(content)
    assert file in refused(copy, monkeypatch)


@pytest.mark.parametrize("file", [CONFIG, BEFORE, AFTER, "model.safetensors", TOKENIZER])
@pytest.mark.parametrize("kind", ["missing", "folder", "pipe", "link outside", "dangling link", "pickle"])
def test_files(copy: Copy, file: str, kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    path = copy.folder / file
    content = path.read_bytes()
    path.unlink()
    if kind == "folder":
        path.mkdir()
    elif kind == "pipe":
        os.mkfifo(path)
    elif kind == "link outside":
        (copy.folder.parent / file).write_bytes(content)
        path.symlink_to(f"../{file}")
    elif kind == "dangling link":
        path.symlink_to("nothing")
    elif kind == "pickle":
        path.write_bytes(b"\x80\x04cposix\nsystem\n(X\x0b\x00\x00\x00touch pwnedtR.")
    assert file in refused(copy, monkeypatch)


UNSOUND = "cannot act|predictions that are NaN or infinite"


def first_weight(tensors: dict[str, torch.Tensor]) -> str:
    return next(name for name, value in tensors.items() if value.is_floating_point() and value.ndim == 2)


def replaced(change: Callable[[torch.Tensor], torch.Tensor]) -> Change:
    return lambda tensors: tensors.update({first_weight(tensors): change(tensors[first_weight(tensors)])})


@pytest.mark.parametrize(
    ("change", "line"),
    [
        (lambda tensors: [tensors.pop(name) for name in list(tensors) if "action_pre" in name], r"lacks \d+ of \d+"),
        (lambda tensors: tensors.pop(first_weight(tensors)), r"lacks 1 of \d+ weights"),
        (lambda tensors: [tensors.update({f"module.{name}": tensors.pop(name)}) for name in list(tensors)], "lacks"),
        (lambda tensors: tensors.update(evil=torch.zeros(1000)), r"has 1 weights that the policy does not \(evil\)"),
        (replaced(lambda value: value[1:].clone()), "has shape"),
        (replaced(lambda value: value.half()), "is torch.float16, the policy's torch.float32"),
        (replaced(lambda value: value.to(torch.int32)), "is torch.int32"),
        (replaced(lambda value: value.index_fill(0, torch.tensor([0]), float("nan"))), "is not finite"),
        (replaced(lambda value: value.index_fill(1, torch.tensor([3]), float("inf"))), "is not finite"),
        (lambda tensors: [value.fill_(1e38) for value in tensors.values() if value.is_floating_point()], UNSOUND),
        (lambda tensors: [value.zero_() for name, value in tensors.items() if "initted" in name], "codebook is empty"),
    ],
)  # fmt: skip
def test_weights(copy: Copy, change: Change, line: str, monkeypatch: pytest.MonkeyPatch) -> None:
    copy.edit_tensors("model.safetensors", change)
    file = "" if line == UNSOUND else r"model\.safetensors.*"
    assert re.search(file + line, refused(copy, monkeypatch))


@pytest.mark.parametrize("header", [{"a": {"dtype": "F32", "shape": [2**40], "data_offsets": [0, 2**42]}}, {"a": 7}])
def test_a_header_that_lies(copy: Copy, header: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    written = json.dumps(header).encode()
    (copy.folder / "model.safetensors").write_bytes(len(written).to_bytes(8, "little") + written)
    assert "model.safetensors is no file of weights" in refused(copy, monkeypatch)


def replacing(content: str, times: int) -> dict[str, Any]:
    return {
        "type": "Sequence",
        "normalizers": [{"type": "Replace", "pattern": {"Regex": "."}, "content": content}] * times,
    }


@pytest.mark.parametrize(
    ("change", "line"),
    [
        (lambda made: made["model"].update(vocab={}), "holds no tokenizer .*UNK"),
        (lambda made: made["model"]["vocab"].update(go=10**6), "gives the id 1000000, but the language encoder knows"),
        (lambda made: made.update(normalizer=replacing("ab" * 500, 3)), "makes a text 1003003001 times as long"),
        (
            lambda made: made.update(
                padding={
                    "strategy": {"Fixed": 10**10}, "direction": "Right", "pad_to_multiple_of": None, "pad_id": 0,
                    "pad_type_id": 0, "pad_token": "[PAD]",
                }
            ),
            "it pads",
        ),
        (lambda made: made.update(model={"type": "Evil"}), "holds no tokenizer"),
        (lambda made: made.clear(), "holds no tokenizer"),
    ],
)  # fmt: skip
def test_tokenizers(copy: Copy, change: Change, line: str, monkeypatch: pytest.MonkeyPatch) -> None:
    path = copy.folder / TOKENIZER
    made = json.loads(load_file(path)["tokenizer"].numpy().tobytes())
    change(made)
    save_file({"tokenizer": torch.frombuffer(bytearray(json.dumps(made).encode()), dtype=torch.uint8)}, path)
    assert re.search(r"lisa_instructions\.safetensors.*" + line, refused(copy, monkeypatch))


def test_statistics_that_are_not_finite(copy: Copy, monkeypatch: pytest.MonkeyPatch) -> None:
    copy.edit_tensors("*_normalizer_processor*", lambda tensors: tensors["action.mean"].fill_(float("nan")))
    assert "action.mean is not finite" in refused(copy, monkeypatch)


@pytest.mark.parametrize("missing", ["state_file", "action.std"])
def test_statistics_that_are_missing(copy: Copy, missing: str, monkeypatch: pytest.MonkeyPatch) -> None:
    copy.edit(AFTER, configured("unnormalizer", norm_map={"ACTION": "MEAN_STD"}))
    if missing == "state_file":
        copy.edit(AFTER, step("unnormalizer", lambda found: found.pop("state_file")))
    else:
        copy.edit_tensors("*_unnormalizer_processor*", lambda tensors: tensors.pop(missing))
    assert "MEAN_STD of action lacks the statistics" in refused(copy, monkeypatch)


def test_statistics_of_another_shape(copy: Copy, monkeypatch: pytest.MonkeyPatch) -> None:
    copy.edit(AFTER, configured("unnormalizer", norm_map={"ACTION": "MEAN_STD"}))
    copy.edit_tensors("*_unnormalizer_processor*", lambda tensors: tensors.update({"action.std": torch.ones(1000, 1)}))
    assert "makes no finite action" in refused(copy, monkeypatch)


def test_links_within_the_hubs_cache_are_no_links_outside(lisa: Path, tmp_path: Path) -> None:
    snapshot, blobs = tmp_path / "models--me--lisa" / "snapshots" / ("a" * 40), tmp_path / "models--me--lisa" / "blobs"
    snapshot.mkdir(parents=True)
    blobs.mkdir()
    for path in lisa.iterdir():
        (blobs / f"blob_{path.name}").write_bytes(path.read_bytes())
        (snapshot / path.name).symlink_to(f"../../blobs/blob_{path.name}")
    load_checkpoint(load_config(str(snapshot)))
