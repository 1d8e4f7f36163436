"""What a user specifies: scenes, their numbers and keys, and scene files."""
