"""Board programming: the Arduino library with message headers, and the settings of a board."""
