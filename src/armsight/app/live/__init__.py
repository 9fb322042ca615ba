"""Live measurement for screens: a process that measures at the cameras' pace and tells what it sees."""
