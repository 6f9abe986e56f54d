"""The few names that original demonstration files use: numpy arrays of plain numbers, and gym-minigrid's actions."""

from typing import Any

import numpy as np

from dataset_converters.babyai.demonstration import ACTIONS
from dataset_converters.babyai.pickle_reader import Part, Parts, PickleRefusedError

_DTYPES = {
    code: np.dtype(code) for code in ("b1", "u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8")
}  # little-endian on every machine that minigrid runs on


def _dtype(code: Any, align: Any = False, copy: Any = False) -> Part:
    """A dtype of plain integers."""
    code = code.decode("ascii", "replace") if isinstance(code, bytes) else code
    if not isinstance(code, str) or code not in _DTYPES:
        raise PickleRefusedError("it holds an array of something else than integers")

    def with_state(state: Any) -> Part:
        """(version, byte order, subdtype, names, fields, ...): a plain dtype has none of the middle three."""
        plain = isinstance(state, tuple) and len(state) >= 5 and state[2:5] == (None, None, None)
        if not plain or state[1] not in ("<", "|", "=", b"<", b"|", b"="):
            raise PickleRefusedError("it holds an array with a structured or big-endian dtype")
        return made

    made = Part("a dtype", build=with_state, value=_DTYPES[code])
    return made


def as_bytes(value: Any) -> bytes:
    """Bytes, however a file spells them: python 2 has no bytes, and the reader keeps its strings as latin-1 text."""
    if isinstance(value, bytes):
        return value
    if isinstance(value, str):
        try:
            return value.encode("latin-1")
        except UnicodeEncodeError:
            pass
    raise PickleRefusedError("it holds something else where bytes are expected")


def _array(shape: Any, dtype: Any, fortran: Any, raw: Any) -> np.ndarray:
    kind = dtype.value if isinstance(dtype, Part) else None
    if not isinstance(kind, np.dtype) or not isinstance(shape, tuple) or len(shape) > 8:
        raise PickleRefusedError("it holds a damaged array")
    if not all(type(side) is int and 0 <= side < 2**31 for side in shape):
        raise PickleRefusedError("it holds an array with an impossible shape")
    content = as_bytes(raw)
    count = 1
    for side in shape:
        count *= side
    if count * kind.itemsize != len(content):
        raise PickleRefusedError("it holds an array whose size does not match its shape")
    return np.frombuffer(content, kind).reshape(shape, order="F" if fortran else "C")


def _array_from_state(state: Any) -> np.ndarray:
    if not isinstance(state, tuple) or len(state) != 5:
        raise PickleRefusedError("it holds a damaged array")
    _, shape, dtype, fortran, raw = state
    return _array(shape, dtype, fortran, raw)


def _reconstruct(kind: Any, shape: Any, code: Any) -> Part:
    if kind is not _NDARRAY:
        raise PickleRefusedError("it holds an array of an unknown kind")
    return Part("an array", build=_array_from_state)


def _scalar(dtype: Any, raw: Any) -> int:
    return int(_array((), dtype, False, raw))


def _encode(text: Any, encoding: Any) -> bytes:
    """`_codecs.encode` is how Python 3 writes bytes in protocols 0 to 2."""
    if not isinstance(text, str) or encoding not in ("latin1", "latin-1"):
        raise PickleRefusedError("it encodes text in an unexpected way")
    return as_bytes(text)


def _action(value: Any) -> int:
    if type(value) is not int or not 0 <= value < len(ACTIONS):
        raise PickleRefusedError(f"it holds an action outside 0..{len(ACTIONS) - 1}")
    return value


def _attribute(owner: Any, name: Any) -> Any:
    """`getattr`, for the only two chains that enumerations need: MiniGridEnv.Actions and Actions.<member>."""
    if owner is _ENVIRONMENT and name == "Actions":
        return _ACTIONS
    if owner is _ACTIONS and name in ACTIONS:
        return ACTIONS.index(name)
    raise PickleRefusedError("it asks for an attribute of something, which is refused")


_NDARRAY = Part("numpy.ndarray")
_ENVIRONMENT = Part("MiniGridEnv")
_ACTIONS = Part("MiniGridEnv.Actions", _action)

ARRAY_PARTS: Parts = {
    ("numpy", "ndarray"): _NDARRAY,
    ("numpy", "dtype"): Part("numpy.dtype", _dtype),
    ("_codecs", "encode"): Part("_codecs.encode", _encode),
}
for _core in ("numpy.core", "numpy._core"):
    ARRAY_PARTS[_core + ".multiarray", "_reconstruct"] = Part("numpy's _reconstruct", _reconstruct)
    ARRAY_PARTS[_core + ".multiarray", "scalar"] = Part("numpy's scalar", _scalar)
    ARRAY_PARTS[_core + ".numeric", "_frombuffer"] = Part(
        "numpy's _frombuffer", lambda raw, dtype, shape, order: _array(shape, dtype, order == "F", raw)
    )

DEMO_PARTS: Parts = {
    **ARRAY_PARTS,
    ("builtins", "getattr"): Part("getattr", _attribute),
    ("__builtin__", "getattr"): Part("getattr", _attribute),
    ("minigrid.core.actions", "Actions"): _ACTIONS,
}
for _module in ("gym_minigrid.minigrid", "babyai.minigrid.minigrid", "minigrid.minigrid_env"):
    DEMO_PARTS[_module, "MiniGridEnv"] = _ENVIRONMENT
    DEMO_PARTS[_module, "MiniGridEnv.Actions"] = _ACTIONS
