"""Turnwright: from an optical prescription to a proven program for a diamond-turning lathe."""
