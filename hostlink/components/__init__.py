"""Components: each offers the robots to programs, to a graph or to a disk. The core holds robots without them."""
