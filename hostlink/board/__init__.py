"""What a board is programmed with: the Arduino library with the headers of messages; the settings of a board."""
