"""The growth room: scene in, folded stages out.

``scene`` says what grows, ``build`` makes its ``body``, ``dynamics`` grows it, ``run`` writes it down and
``health`` checks it. What is known without growing: ``theory``, ``equilibrium``.
"""

if __name__ != "morphofold.sim":
    raise ImportError("this folder is imported as morphofold.sim, never as sim: use `import morphofold.sim`")
