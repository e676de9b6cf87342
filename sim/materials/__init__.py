"""Materials, one file each; each defines its volume-preserving energy.

An element's energy per grown volume is ``mu u(i1, i2)`` plus a volumetric term. ``i1`` and ``i2`` are the first two
invariants of A A^T for the volume-preserving part of A: ``J^-2/3 tr(A^T A)`` and ``J^-4/3`` times the second. A file
has a ``Material``, which defines u and its derivatives once, in arithmetic that works in NumPy and numba, and
``Options``, its keys in the table ``[material]`` of a scene. The kernels compile for the given material: if u does not
depend on ``i2``, no time is spent on it.
"""

from typing import Any, Protocol

from numba import njit, types
from numba.extending import overload


class Material(Protocol):
    """Interface of a material. It is a ``NamedTuple`` whose fields are its parameters, numbers.

    The three functions take and return arrays of one shape, or numbers; constants may be returned as plain numbers.
    At rest, i1 = i2 = 3, ``u`` must be 0 and 2 (u1 + u2) must be 1: then mu is the shear modulus.
    """

    @property
    def uses_i2(self) -> bool:
        """Whether u depends on i2."""

    def energy(self, i1: Any, i2: Any) -> Any:
        """u, over mu."""

    def slopes(self, i1: Any, i2: Any) -> tuple[Any, Any]:
        """Derivatives of u by i1 and i2."""

    def curvatures(self, i1: Any, i2: Any) -> tuple[Any, Any, Any]:
        """Second derivatives of u: by i1 twice, by i1 and i2, by i2 twice."""


# for numba: the functions of a material by its type, and whether it depends on i2 -----------------------------------


_INLINE_OPTIONS: Any = {"forceinline": True, "fastmath": {"contract", "nsz", "arcp", "nnan", "ninf"}}


def _material_class(material: types.Type) -> Any:
    return material.instance_class if isinstance(material, types.BaseNamedTuple) else None  # type: ignore[attr-defined]


def _method(name: str) -> Any:
    """A method of materials as a function (material, i1, i2), for kernels."""

    def method_of(material, i1, i2):
        return getattr(material, name)(i1, i2)

    @overload(method_of, jit_options=_INLINE_OPTIONS, strict=False)
    def _method_of(material, i1, i2):
        return getattr(_material_class(material), name, None)

    return method_of


energy_of, slopes_of, curvatures_of = _method("energy"), _method("slopes"), _method("curvatures")


def uses_i2(material):
    """``material.uses_i2``, for kernels."""
    return material.uses_i2


@overload(uses_i2, jit_options=_INLINE_OPTIONS, strict=False)
def _uses_i2(material):
    material_class = _material_class(material)
    if material_class is None:
        return None
    return (lambda material: True) if material_class.uses_i2.fget(None) else (lambda material: False)


@njit(**_INLINE_OPTIONS)
def stiffness_bound(material, i1, i2):
    """A bound on the second derivative of u by the volume-preserving part of A, 1 for a neo-Hookean material."""
    u1, u2 = slopes_of(material, i1, i2)
    u11, u12, u22 = curvatures_of(material, i1, i2)
    return 2.0 * (u1 + u2 * i1) + 4.0 * i1 * (u11 + 2.0 * u12 * i1 + u22 * i1 * i1)
