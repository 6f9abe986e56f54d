"""Plans of skill codes from the command line and from Python."""

from pathlib import Path

import pytest
import torch
from lerobot.configs import PreTrainedConfig
from test_policy_rollouts import TASKS, actions_of, live_observations
from tiny_policies import Training, training

from lerobot_lisa.errors import UserError


def codes_of(made: Training, steps: int) -> list[list[int]]:
    """Skill codes of each step, (T, B)."""
    observations = live_observations(made, 2, steps)
    made.policy.reset()
    codes = []
    for step in range(steps):
        actions_of(made, observations, range(step, step + 1), TASKS[:2])
        codes.append(made.policy.skill_codes.tolist())
    return codes


def test_a_policy_follows_a_plan(continuous: Path) -> None:
    made = training("lisa", continuous).warm_up()
    own = codes_of(made, 8)

    made.policy.follow("4*2,1*3,?")
    steered = codes_of(made, 8)
    made.policy.follow(None)

    assert steered[:5] == [[4, 4]] * 2 + [[1, 1]] * 3
    assert codes_of(made, 8) == own


def test_the_predictors_choice_is_known_under_a_plan(continuous: Path) -> None:
    made = training("lisa", continuous).warm_up()
    chosen = codes_of(made, 1)[0]
    made.policy.follow("3")

    assert codes_of(made, 1) == [[3, 3]]
    assert made.policy.predicted_codes.tolist() == chosen


def test_the_loss_is_the_same(continuous: Path) -> None:
    made = training("lisa", continuous, dropout=0.0).warm_up().policy.eval()
    batch = training("lisa", continuous).batch([0, 8])
    before, _ = made.forward(batch)

    made.follow("3")

    assert torch.equal(made.forward(batch)[0], before)


def test_a_plan_is_an_option_of_every_lerobot_program(continuous: Path, tmp_path: Path) -> None:
    training("lisa", continuous).policy.save_pretrained(tmp_path)

    for plan in ("3", "3*20,2*20", "?*10,4"):
        assert PreTrainedConfig.from_pretrained(tmp_path, cli_overrides=[f"--skill_plan={plan}"]).skill_plan == plan


def test_bad_plans_are_refused(continuous: Path) -> None:
    policy = training("lisa", continuous).policy

    with pytest.raises(UserError, match="is no part of a plan"):
        policy.follow("1**3")
    with pytest.raises(UserError, match="'all of them' is no phrase that this policy knows"):
        policy.follow("all of them")
    assert policy.config.skill_plan is None
    with pytest.raises(UserError, match=r"there is no skill code 9{20};") as caught:
        policy.follow("9" * 5000)
    assert len(str(caught.value)) < 300
    with pytest.raises(UserError, match="codes 0 to 4"):
        training("lisa", continuous, skill_plan="5")


def test_codes_by_name(symbolic: Path) -> None:
    """A name is the code that is nearest to its words; what a code is called finds it again."""
    made = training("lisa", symbolic).warm_up(5)
    policy, lexicon = made.policy.eval(), made.policy.config.lexicon
    phrase = next(phrase for phrase in lexicon if " " in phrase)

    for label in policy.code_labels:
        number, words = label.split(" ", 1)
        assert policy.find_code(number) == int(number)
        assert words in lexicon
    codes = policy.network.quantizer.embed(torch.arange(policy.n_codes))[:, 0]
    said = policy.network.language.encode_names([lexicon[phrase]])
    assert policy.find_code(phrase) == (codes - said).square().sum(1).argmin()

    policy.follow(f"{phrase}*2, 1")
    policy.reset()
    followed = []
    for step in range(4):
        frames = {key: torch.zeros(1, *f.shape) for key, f in policy.config.input_features.items()}
        policy.select_action(made.preprocessor({**frames, "task": "go to the red ball"}))
        followed.append(int(policy.skill_codes))
        assert step < 9
    assert followed == [policy.find_code(phrase)] * 2 + [1] * 2


def test_names_of_codes_with_several_parts(symbolic: Path) -> None:
    made = training("lisa", symbolic, n_code_parts=2, codebook_size=3).warm_up(5)
    policy = made.policy.eval()
    first, second, *_ = policy.config.lexicon

    assert policy.n_codes == 9
    assert all(" / " in label for label in policy.code_labels)
    assert 0 <= policy.find_code(f"{first} / {second}") < 9
    with pytest.raises(UserError, match="names 1 parts, but a code has 2"):
        policy.find_code(first)


def test_names_of_codes_with_made_up_parts(symbolic: Path) -> None:
    """They have numbers, and may be left out of a name: then they are what training used most."""
    policy = training("lisa", symbolic, n_own_parts=1, codebook_size=3, own_codebook_size=2).warm_up(5).policy.eval()
    phrase = next(iter(policy.config.lexicon))

    assert policy.n_codes == 6
    assert [label.rsplit(" / ", 1)[1] for label in policy.code_labels] == ["#0", "#1"] * 3
    numbered = [policy.find_code(f"{phrase} / #{number}") for number in (0, 1)]
    assert [code % 2 for code in numbered] == [0, 1]
    assert numbered[0] // 2 == numbered[1] // 2
    assert policy.find_code(phrase) == numbered[policy.network.quantizer.most_used[-1]]
    policy.follow(f"{phrase} / #1*4, {phrase}")
    with pytest.raises(UserError, match="parts with a number are #0 to #1"):
        policy.find_code(f"{phrase} / #2")
    with pytest.raises(UserError, match=r"names 2 parts, but a code has 1 parts, and 1 with a number \(#0\)"):
        policy.find_code(f"{phrase} / {phrase}")


def test_made_up_parts_are_beside_copied_ones(symbolic: Path) -> None:
    for other in ({"copy_words": False}, {"quantizer": "fsq"}):
        with pytest.raises(UserError, match="they need vq and copy_words"):
            training("lisa", symbolic, n_own_parts=1, **other)


def test_codes_without_words_have_no_names(symbolic: Path) -> None:
    policy = training("lisa", symbolic, copy_words=False).warm_up().policy

    assert policy.code_labels is None
    with pytest.raises(UserError, match="give a number"):
        policy.follow("red")


def test_codes_that_are_not_placed_yet(symbolic: Path) -> None:
    """A training of too few steps for `quantizer_warmup_steps` ends so: nothing can be followed, by number or name."""
    policy = training("lisa", symbolic).policy

    assert policy.n_codes == 0
    assert policy.code_labels is None
    for plan in ("3", "red"):
        with pytest.raises(UserError, match="has no skill codes yet: its training ended before"):
            policy.find_code(plan)
