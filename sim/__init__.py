"""The growth room: scene in, folded stages out."""

if __name__ != "morphofold.sim":
    raise ImportError("this folder is imported as morphofold.sim, never as sim: use `import morphofold.sim`")
