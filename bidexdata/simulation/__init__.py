"""The MuJoCo scene of hands and one object: shared by selection, validation and pictures."""
