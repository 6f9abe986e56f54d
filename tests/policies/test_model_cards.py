"""A model card quotes a dataset's words and a user's names as text, short and on one line."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tiny_policies import training

from lerobot_lisa.policies.model_card import LONGEST, plain

HOSTILE = [
    "go <script>alert(1)</script> <img src=x onerror=alert(2)>",
    "red\n# Heading\n\n```bash\nrm -rf ~\n```",
    "`open` | the | door |",
    "word " * 20_000,
    "[click](javascript:alert(3))",
]


@pytest.mark.parametrize("kind", ["lisa", "lang_dt", "babyai_rnn", "lang_bc"])
def test_hostile_instructions_and_names(kind: str, symbolic: Path) -> None:
    made = training(kind, symbolic)
    usual = str(made.policy.generate_model_card("local/tiny", kind, None, None, None, made.dataset.meta))
    tasks = made.dataset.meta.tasks
    made.dataset.meta.tasks = tasks.set_axis([*HOSTILE, *tasks.index[len(HOSTILE) :]][: len(tasks)])
    made.policy.config.language_encoder = "a|b\n## c"
    made.policy.config.repo_id = "me/<b>x</b>\n# y"

    card = str(made.policy.generate_model_card("local/tiny", kind, None, None, None, made.dataset.meta))

    text = card.split("---", 2)[2]
    for bad in ("<script", "<img", "<b>", "\n# Heading", "rm -rf ~\n", "\n## c"):
        assert bad not in text
    assert "- `[click](javascript:alert(3))`" in text
    assert max(map(len, text.splitlines())) < 2 * LONGEST
    assert len(card.splitlines()) == len(usual.splitlines())


@given(st.text(max_size=300))
def test_any_text(text: str) -> None:
    shown = plain(text)

    assert len(shown) <= LONGEST + 3
    assert len(shown.splitlines()) <= 1
    assert not set("`|<>\\") & set(shown)
    assert plain(shown) == shown or len(text) > LONGEST
