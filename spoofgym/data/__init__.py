"""Readers of what others have recorded: tracks of flights, and navigation files."""
