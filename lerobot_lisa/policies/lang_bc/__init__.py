"""LCBC: LOReL's language-conditioned behaviour cloning."""
