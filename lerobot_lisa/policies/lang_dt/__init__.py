"""Lang-DT: the flat language-conditioned Decision Transformer, LISA's baseline."""
