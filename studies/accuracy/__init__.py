"""The study of accuracy: errors and times of many settings of the solver and the measuring room, and of peers."""
