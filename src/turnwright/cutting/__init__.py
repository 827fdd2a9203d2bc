"""What cutting does: how thick the chip is, which forces act, and whether the cut stays ductile."""
