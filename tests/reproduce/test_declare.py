"""Changes of code that change no result are declared, and then make no row stale."""

import json
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from lerobot_lisa import code_version
from lerobot_lisa.reproduce import declare

FILE = "lerobot_lisa/networks.py"


def git(folder: Path, *words: str) -> None:
    subprocess.run(["git", "-C", str(folder), "-c", "user.name=a", "-c", "user.email=a@b", *words], check=True)


@pytest.fixture
def checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A repository with one committed file, in place of ours."""
    same = tmp_path / "lerobot_lisa" / "same_results.json"
    same.parent.mkdir()
    same.write_text("[]\n")
    (tmp_path / FILE).write_text("x = 1\n")
    git(tmp_path, "init", "-q")
    git(tmp_path, "add", ".")
    git(tmp_path, "commit", "-qm", "one")
    monkeypatch.setattr(declare, "_CHECKOUT", tmp_path)
    for module in (declare, code_version):
        monkeypatch.setattr(module, "SAME_RESULTS", same)
    return tmp_path


@pytest.fixture
def means(checkout: Path) -> Callable[[str], str]:
    """What the file means with other code in it, for who looks at declarations."""

    def write(code: str) -> str:
        forget()
        (checkout / FILE).write_text(code)
        return code_version._meaning(checkout / FILE)

    return write


def forget() -> None:
    """What is cached of files: they change here."""
    for name in ("_closure", "_source", "_imported", "_own_meaning", "_same_results"):
        getattr(code_version, name).cache_clear()


@pytest.fixture(autouse=True)
def _files_are_read_again(checkout: Path) -> Iterator[None]:
    forget()
    yield
    forget()


def test_what_is_declared_means_what_it_meant(
    checkout: Path, means: Callable[[str], str], capsys: pytest.CaptureFixture[str]
) -> None:
    first, second = means("x = 1\n"), means("x = 2 - 1\n")
    assert first != second

    assert declare.main(["HEAD", "one is one"]) == 0

    assert capsys.readouterr().out == f"declared: {FILE}\n"
    (change,) = json.loads((checkout / "lerobot_lisa" / "same_results.json").read_text())
    assert (change["file"], change["why"]) == (FILE, "one is one")
    assert means("x = 2 - 1\n") == first
    assert means("x = 2\n") not in (first, second)  # one change more


def test_a_change_after_a_declared_one(checkout: Path, means: Callable[[str], str]) -> None:
    first = means("x = 1\n")
    means("x = 2 - 1\n")
    assert declare.main(["HEAD", "one is one"]) == 0
    git(checkout, "commit", "-qam", "two")
    means("x = 3 - 2\n")
    assert declare.main(["HEAD", "one is still one"]) == 0
    assert means("x = 3 - 2\n") == first


def test_code_that_has_moved_to_a_new_file(checkout: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = checkout / "lerobot_lisa"
    monkeypatch.setattr(code_version, "PACKAGE", package)

    def fingerprint() -> dict[str, str]:
        forget()
        return code_version.fingerprint(["lerobot_lisa.networks"])

    first = fingerprint()
    (package / "moved.py").write_text("y = 1\n")
    (checkout / FILE).write_text("from lerobot_lisa.moved import y as x\n")
    git(checkout, "add", ".")
    assert fingerprint() != first

    assert declare.main(["HEAD", "one is one, wherever it is"]) == 0

    assert fingerprint() == first
    (package / "moved.py").write_text("y = 2\n")
    assert fingerprint().keys() == {"networks", "moved"}


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["HEAD", "why"], "since HEAD no code has changed that is not declared yet"),
        (["nowhere", "why"], "git diff: "),
        (["HEAD", "why", "elsewhere.py"], "since HEAD no code"),
    ],
)
def test_nothing_to_declare(
    checkout: Path, arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (checkout / FILE).write_text("x = 1  # a comment\n")
    (checkout / "lerobot_lisa" / "card.md").write_text("# no code\n")
    git(checkout, "add", ".")
    assert declare.main(arguments) == 1
    assert f"error: {said}" in capsys.readouterr().err
    assert (checkout / "lerobot_lisa" / "same_results.json").read_text() == "[]\n"


def test_a_change_that_changes_nothing_unless_an_option_is_set(checkout: Path) -> None:
    def fingerprint(*options: str) -> str:
        forget()
        return code_version._meaning(checkout / FILE, set(options))

    first = fingerprint()
    (checkout / FILE).write_text("x = 2 - 1\n")
    assert declare.main(["HEAD", "only a late one is another", "--unless", "policy.late"]) == 0

    assert fingerprint() == fingerprint("policy.early") == first
    assert fingerprint("policy.early", "policy.late") not in (first, "")


def test_what_is_declared_here() -> None:
    """Each change once, with its reason, and none leads back to itself."""
    changes = json.loads(code_version.SAME_RESULTS.read_text(encoding="utf-8"))
    after = {change["is"]: change["was"] for change in changes}
    assert len(after) == len(changes)
    for change in changes:
        assert change["why"]
        assert (code_version.PACKAGE.parent / change["file"]).is_file(), change["file"]
        meant = change["is"]
        for _ in changes:
            meant = after.get(meant, meant)
        assert meant not in after
