"""Settings of the Lang-BC policy."""

from dataclasses import dataclass

from lerobot.configs import PreTrainedConfig

from lerobot_lisa.policies.baseline_configuration import BaselineConfig


@PreTrainedConfig.register_subclass("lang_bc")
@dataclass
class LangBCConfig(BaselineConfig):
    """LCBC, LOReL's language-conditioned behaviour cloning (Nair et al., CoRL 2021, arXiv:2109.01115).

    The LISA paper's "original" on LOReL. Defaults are LISA's and Lang-DT's, which it is compared with.
    """
