"""How long a test waits for another process before it fails: long enough for a busy machine."""

PATIENCE_S = 600
