"""Settings of the LISA policy."""

from dataclasses import dataclass, field
from typing import ClassVar

from lerobot.configs import FeatureType, PreTrainedConfig

from lerobot_lisa.errors import UserError
from lerobot_lisa.policies.accepted_settings import check_choice
from lerobot_lisa.policies.base_configuration import EpisodePolicyConfig
from lerobot_lisa.policies.lisa.quantizer_choices import QUANTIZERS, codebook_sizes, n_codes

MOST_CODES = 1_000_000


@PreTrainedConfig.register_subclass("lisa")
@dataclass
class LisaConfig(EpisodePolicyConfig):
    """LISA (Garg et al., NeurIPS 2022): language to discrete skill codes to actions. Defaults: the paper's, appendix D.

    Attributes:
        skill_predictor: "transformer" over the instruction and all observations so far; or "mlp", an ablation of the
            paper (appendix): it hears the mean of the instruction's tokens and sees the chunk's first observation.
        n_predictor_layers: Transformer blocks of the skill predictor f.
        n_policy_layers: Transformer blocks of the policy pi.
        horizon: H, steps that one skill code lasts; with learned termination at most.
        termination_stride: Learned termination: every so many steps, of which `horizon` is a multiple, the skill
            predictor is asked anew, and a skill is over when it says another code. 0: after `horizon` steps, the
            paper's.
        skill_steps: With learned termination, how long skills should last on average: codes that are changed more often
            are charged for.
        termination_weight: Of this charge, 1 for codes that are changed twice as often.
        predictor_stride: The skill predictor looks at steps 0, this, twice this, ..., of which `horizon` is a multiple,
            in training and in rollouts; 1 is the paper's. None: as often as it is asked if there are pictures or it is
            an "mlp", else 1.
        shared_observation_encoder: Skill predictor and policy see with the same encoder, at half the cost. The paper
            does not say; with an encoder each, LISA has more parameters than Lang-DT. None: if there are pictures.
        copy_words: The skill predictor copies phrases of the instruction, and codes lie among words: they can be read,
            asked with and set by name. The paper's skill predictor (section 3.2) makes up numbers of its own: false.
        quantizer: "vq" (the paper's); "residual_vq"; "fsq" (finite scalars, whose levels are `fsq_levels`); or
            "continuous", an ablation of the paper (appendix, "Continuous skill codes"): there is then nothing to read
            or to steer, and settings of the codebook mean nothing.
        n_code_parts: Of how many parts a skill code consists, each with a codebook of its own: with "vq" one for each
            of several copied phrases (a product quantiser), with "residual_vq" one after another.
        codebook_size: Codes of each part; K, the number of skill codes, is the product over the parts.
        n_own_parts: Further parts that the skill predictor makes up, beside the phrases that it copies: for what nobody
            says, such as where to search. With "vq" and `copy_words`.
        own_codebook_size: Codes of each of these.
        code_width: Numbers per code that the skill predictor makes up; copied phrases stay among words.
        fsq_levels: Levels of each number of "fsq"; K is their product.
        codebook_decay: Of the moving averages that are the codes.
        commitment_weight: lambda, weight of the commitment loss.
        dead_code_threshold: A code that stands for fewer embeddings of a batch than this, in the moving average, is put
            onto a random embedding; 0 never does. The paper does not mention it; without it codes die.
        quantizer_warmup_steps: Training steps before codes are placed; until then skills are continuous. About half of
            a training: what to copy has to be learned first. The paper does not mention it (0).
        freeze_codebook: Keep the codes of the checkpoint that training starts from (`--policy.path`): not one number of
            the codebook moves, its statistics included. The paper transfers skills so (appendix).
        skill_plan: Skill codes to follow in rollouts in place of the skill predictor's, such as "14" for the whole
            episode or "14*20,2*20" (see `networks.skill_plan`); None: none. The loss takes no notice of it.
        optimizer_lr_skill_predictor: Rate of the skill predictor and of the codebook's projections. None: the paper's
            1e-5, which fine-tunes; with pictures `optimizer_lr`.
    """

    skill_predictor: str = "transformer"
    n_predictor_layers: int = 1
    n_policy_layers: int = 1
    horizon: int = 10
    termination_stride: int = 0
    skill_steps: float = 10
    termination_weight: float = 1.0
    predictor_stride: int | None = None
    shared_observation_encoder: bool | None = None
    copy_words: bool = True
    quantizer: str = "vq"
    n_code_parts: int = 1
    codebook_size: int = 20
    n_own_parts: int = 0
    own_codebook_size: int = 20
    code_width: int = 16
    fsq_levels: list[int] = field(default_factory=lambda: [5, 4])
    codebook_decay: float = 0.99
    commitment_weight: float = 0.25
    dead_code_threshold: float = 1.0
    quantizer_warmup_steps: int = 1000
    freeze_codebook: bool = False

    skill_plan: str | None = None

    optimizer_lr_skill_predictor: float | None = None

    BOUNDS: ClassVar[dict[str, tuple[float, float]]] = {
        **EpisodePolicyConfig.BOUNDS,
        "n_predictor_layers": (1, 128),
        "n_policy_layers": (1, 128),
        "horizon": (1, 10**6),
        "termination_stride": (0, 10**6),
        "skill_steps": (1, 10**6),
        "termination_weight": (0, 1e6),
        "predictor_stride": (1, 10**6),
        "n_code_parts": (1, 8),
        "codebook_size": (1, 10**6),
        "n_own_parts": (0, 8),
        "own_codebook_size": (1, 10**6),
        "code_width": (1, 8192),
        "codebook_decay": (0, 0.999999),
        "commitment_weight": (0, 1e6),
        "dead_code_threshold": (0, 1e9),
        "quantizer_warmup_steps": (0, 10**9),
        "optimizer_lr_skill_predictor": (0, 100),
    }

    EXCERPT_STEPS: ClassVar[int] = 80
    LOOKBACK_STEPS: ClassVar[int] = 200  # of which the skill predictor looks at every `horizon`-th

    def __post_init__(self) -> None:
        """Refuse settings that cannot work, before anything is loaded or allocated."""
        super().__post_init__()
        check_choice(self, "skill_predictor", ("transformer", "mlp"))
        check_choice(self, "quantizer", tuple(QUANTIZERS))
        if self.n_own_parts and (self.quantizer != "vq" or not self.copy_words):
            raise UserError("--policy.n_own_parts are beside copied phrases in a codebook: they need vq and copy_words")
        if self.freeze_codebook and self.quantizer == "continuous":
            raise UserError("--policy.freeze_codebook=true: continuous skills have no codebook to freeze")
        if not 1 <= len(self.fsq_levels) <= 16 or not all(3 <= level <= 1000 for level in self.fsq_levels):
            raise UserError(f"--policy.fsq_levels={self.fsq_levels!r:.60} must be 1 to 16 numbers from 3 to 1000")
        if self.termination_stride:
            self._check_termination()
        if self.predictor_stride and self.question_stride % self.predictor_stride:
            name = "termination_stride" if self.termination_stride else "horizon"
            raise UserError(
                f"--policy.{name}={self.question_stride} must be a multiple of --policy.predictor_stride="
                f"{self.predictor_stride}: the skill predictor is asked at steps that it looks at"
            )
        if (codes := self.n_codes) > MOST_CODES:
            raise UserError(
                f"the policy would have {codes:.1e} skill codes, {MOST_CODES:,} is the most: choose a smaller "
                "--policy.codebook_size, or fewer --policy.n_code_parts or --policy.fsq_levels"
            )

    def _check_termination(self) -> None:
        if self.horizon % self.termination_stride:
            raise UserError(
                f"--policy.horizon={self.horizon} must be a multiple of --policy.termination_stride="
                f"{self.termination_stride}: a skill is over at a step at which the skill predictor is asked"
            )
        if self.quantizer == "continuous":
            raise UserError(
                "--policy.termination_stride: a skill is over when another code is said, but skills are continuous"
            )
        if self.excerpt_steps:
            raise UserError(
                "--policy.termination_stride: when a skill began may depend on all that was before, so that whole "
                "episodes have to be learned from: leave --policy.excerpt_steps at 0"
            )

    def fill_in(self) -> None:
        """Choose what the user has left open and what depends on the features."""
        if self.termination_stride and self.excerpt_steps is None:
            self.excerpt_steps = 0
        super().fill_in()
        shows_pictures = any(feature.type is FeatureType.VISUAL for feature in (self.input_features or {}).values())
        if self.shared_observation_encoder is None:
            self.shared_observation_encoder = shows_pictures
        if self.predictor_stride is None:
            self.predictor_stride = self.question_stride if shows_pictures or self.skill_predictor == "mlp" else 1
        if self.optimizer_lr_skill_predictor is None:
            self.optimizer_lr_skill_predictor = self.optimizer_lr if shows_pictures else 1e-5

    def _fill_in_as_it_was(self) -> None:
        """Choose what was done before there was a choice."""
        super()._fill_in_as_it_was()
        self.predictor_stride = self.predictor_stride or 1
        self.shared_observation_encoder = bool(self.shared_observation_encoder)

    @property
    def learned_steps(self) -> int:
        """Steps of the parts of episodes that are learned from, whole chunks; 0: whole episodes."""
        return -(-(self.excerpt_steps or 0) // self.horizon) * self.horizon

    @property
    def question_stride(self) -> int:
        """Steps from one question to the skill predictor to the next."""
        return self.termination_stride or self.horizon

    @property
    def look_stride(self) -> int:
        """Which of the steps before an excerpt are looked at: those that the skill predictor looks at."""
        return self.predictor_stride or 1

    @property
    def n_codes(self) -> int:
        """K, the number of skill codes, all parts taken together; 0 if skills are continuous."""
        return n_codes(self)

    @property
    def skill_predictor_rate(self) -> float:
        """Learning rate of the skill predictor and of the codebook's projections."""
        return 1e-5 if self.optimizer_lr_skill_predictor is None else self.optimizer_lr_skill_predictor

    def _count_parameters(self) -> int:
        width = max(self.code_width, self.dim_model)
        codebook = 2 * width * (sum(codebook_sizes(self)) + self.dim_model)
        return super()._count_parameters() + codebook + self.dim_model * self.horizon
