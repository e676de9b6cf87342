"""Studies and generated pages: figures of the paper, accuracy, folds, speed, pages of docs."""

if __name__ != "morphofold.studies":
    raise ImportError(
        "this folder is imported as morphofold.studies, never as studies: use `import morphofold.studies`"
    )
