"""LOReL's Sawyer tabletop; importing this needs neither MuJoCo nor metaworld."""
