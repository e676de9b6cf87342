"""Studies and generated pages: figures of the paper, accuracy, folds, speed, pages of docs."""
