"""The growth simulation: from a scene to folded stages.

``scene`` defines what grows, ``build`` makes its ``body``, ``dynamics`` grows it, ``run`` writes the results and
``stage_checks`` judges them. ``theory`` and ``equilibrium`` give results without a simulation.
"""

if __name__ != "morphofold.sim":
    raise ImportError("this folder is imported as morphofold.sim, not as sim: use `import morphofold.sim`")
