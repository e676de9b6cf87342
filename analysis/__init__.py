"""The measuring room: one set of measures for simulated and real cortices."""

if __name__ != "morphofold.analysis":
    raise ImportError("this folder is imported as morphofold.analysis, never as analysis: use `import morphofold.analysis`")
