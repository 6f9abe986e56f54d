"""Reads plain data out of pickle files with Python's own unpickler, but nothing in a file can run, import or grow.

`pickle.Unpickler` calls whatever a file asks for. Here

* names are looked up among a few `Part`s, which cannot be changed, and no other exists (`find_class`);
* only parts are called (REDUCE) or given a state (BUILD);
* only the operations that plain data need exist: no dictionaries, sets, instances, persistent ids or extensions;
* every item has at most `MAX_OPERATIONS`, none with more than `_LONGEST` bytes, and only short things are remembered: a
  file of any size takes a few MB beyond the longest item, and the list at the top is handed out item by item.

The last point needs a hand in each operation, so this extends the unpickler in Python, `pickle._Unpickler`. The one in
C holds the whole list (3 GB for a million demonstrations of BossLevel), and its LONG_BINPUT takes 64 GB for 5 bytes; in
a process with a limit on its memory it would still have to hand the whole list over.
"""

import pickle
import struct
from collections.abc import Callable, Generator, Iterator
from typing import Any, ClassVar, NamedTuple

MAX_OPERATIONS = 100_000
"""Most operations of an item; the longest episode of a BabyAI level has 4608 steps, of a few operations each."""

_LONGEST = 2**24  # bytes of one text, number or packed episode
_LONGEST_RECALLED = 300  # the longest BabyAI instruction has 183 characters
_MOST_RECALLED = 5_000_000  # texts and numbers; a file may memoize each instruction

_PLAIN = (  # operations that are done as Python does them
    pickle.PROTO, pickle.MARK, pickle.POP, pickle.EMPTY_LIST, pickle.LIST, pickle.APPEND, pickle.APPENDS,
    pickle.EMPTY_TUPLE, pickle.TUPLE, pickle.TUPLE1, pickle.TUPLE2, pickle.TUPLE3, pickle.NONE, pickle.NEWTRUE,
    pickle.NEWFALSE, pickle.BININT, pickle.BININT1, pickle.BININT2, pickle.LONG1, pickle.INT, pickle.LONG,
    pickle.UNICODE, pickle.BINUNICODE, pickle.SHORT_BINUNICODE, pickle.BINUNICODE8, pickle.STRING, pickle.BINSTRING,
    pickle.SHORT_BINSTRING, pickle.BINBYTES, pickle.SHORT_BINBYTES, pickle.BINBYTES8, pickle.PUT, pickle.BINPUT,
    pickle.LONG_BINPUT, pickle.MEMOIZE, pickle.GET, pickle.BINGET, pickle.LONG_BINGET, pickle.GLOBAL,
    pickle.STACK_GLOBAL,
)  # fmt: skip
_DAMAGE = (ArithmeticError, AttributeError, LookupError, TypeError, ValueError, pickle.PickleError, struct.error)

Buffer = Any  # bytes or mmap


class PickleRefusedError(ValueError):
    """The file holds something that plain data does not need, or is damaged."""


class Part(NamedTuple):
    """A name that a file may refer to, with what it means to call it or to give it a state.

    Nothing in a file can change a part: both meanings are functions of this package that return something new.
    """

    name: str
    call: Callable[..., Any] | None = None
    build: Callable[[Any], Any] | None = None
    value: Any = None  # for this package's own use


Parts = dict[tuple[str, str], Part]


def read_items(data: Buffer, parts: Parts) -> Iterator[tuple]:
    """Yield the tuples of the list that a pickle holds, without ever holding the list.

    Raises:
        PickleRefusedError: at the first thing that is refused; items before it have been yielded.
    """
    left = yield from _Unpickler(data, parts).run(stream=True)
    if type(left) is not list:
        raise PickleRefusedError(f"it holds a {type(left).__name__}; expected a list of demonstrations")
    if any(item is not None for item in left):
        raise PickleRefusedError("it holds something else than demonstrations")


def read_value(data: Buffer, parts: Parts) -> Any:
    """The one value that a pickle holds; raises `PickleRefusedError` if anything in it is refused."""
    reading = _Unpickler(data, parts).run(stream=False)
    try:
        next(reading)
    except StopIteration as end:
        return end.value
    raise AssertionError("only streams yield")


class _Memo(dict):
    """What a file may refer to again: names, numbers and short text; collections are forgotten."""

    count = 0

    def __setitem__(self, index: int, value: Any) -> None:
        self.count += 1
        if isinstance(value, (Part, int)) or (isinstance(value, (str, bytes)) and len(value) <= _LONGEST_RECALLED):
            super().__setitem__(index, value)
        else:
            self.pop(index, None)
        if super().__len__() > _MOST_RECALLED:
            raise PickleRefusedError(f"it refers to more than {_MOST_RECALLED:,} things again")

    def __len__(self) -> int:
        """The index that MEMOIZE, which has none, takes."""
        return self.count

    def __missing__(self, index: int) -> Any:
        raise PickleRefusedError("it refers to a collection twice, which demonstrations do not")


class _Unpickler(pickle._Unpickler):
    """Python's unpickler without what plain data do not need."""

    def __init__(self, data: Buffer, parts: Parts) -> None:
        self._data, self._at, self._parts = data, 0, parts
        self.memo, self.proto, self.encoding, self.errors = _Memo(), 0, "latin-1", "strict"
        self.stack: list[Any] = []
        self.metastack: list[list[Any]] = []
        self.append = self.stack.append

    def read(self, count: int) -> bytes:
        """The next bytes."""
        if count > _LONGEST or count > len(self._data) - self._at:
            raise EOFError
        self._at += count
        return bytes(self._data[self._at - count : self._at])

    def readline(self) -> bytes:
        """The rest of a line of text, with its end."""
        end = self._data.find(b"\n", self._at, self._at + _LONGEST)
        if end < 0:
            raise EOFError
        return self.read(end + 1 - self._at)

    def run(self, stream: bool) -> Generator[tuple, None, Any]:
        """Do all operations; return the value.

        Args:
            stream: yield each tuple of the list at the top when it is complete, and leave None in its place.
        """
        operations = 0
        try:
            while (code := self.read(1)) != pickle.STOP:
                operation = self.dispatch.get(code[0])
                if operation is None:
                    raise PickleRefusedError(f"it uses pickle operation {code!r}, which plain data does not need")
                operation(self)
                operations += 1
                if operations > MAX_OPERATIONS:
                    raise PickleRefusedError(f"it takes more than {MAX_OPERATIONS:,} operations for one item")
                if stream and code == pickle.TUPLE and self._item_is_complete():
                    yield self.stack[-1]
                    self.stack[-1], operations = None, 0
            if len(self.stack) != 1 or self.metastack:
                raise PickleRefusedError("it ends with parts left over")
        except EOFError:
            raise PickleRefusedError("it ends too early (truncated?)") from None
        except PickleRefusedError:
            raise
        except _DAMAGE as error:
            raise PickleRefusedError(f"it is damaged ({type(error).__name__})") from error
        return self.stack[0]

    def _item_is_complete(self) -> bool:
        """Whether the tuple on top of the stack belongs to the list at the top.

        It follows the list (APPEND), or a mark and its like (APPENDS). Inside of an item, a mark is followed by a text.
        """
        if self.metastack:
            return len(self.metastack) == 1 and type(self.stack[0]) is not str
        return len(self.stack) == 2

    def find_class(self, module: str, name: str) -> Part:
        """A name of the file; nothing is imported."""
        part = self._parts.get((module, name))
        if part is None:
            raise PickleRefusedError(f"it refers to {module}.{name}, which is refused")
        return part

    def load_reduce(self) -> None:
        """Call a part."""
        arguments, part = self.stack.pop(), self.stack.pop()
        if type(part) is not Part or part.call is None or type(arguments) is not tuple:
            raise PickleRefusedError(f"it calls {_describe(part)}, which is refused")
        self.append(part.call(*arguments))

    def load_build(self) -> None:
        """Give a state to a part: this makes something new."""
        state, part = self.stack.pop(), self.stack.pop()
        if type(part) is not Part or part.build is None:
            raise PickleRefusedError(f"it changes {_describe(part)}, which is refused")
        self.append(part.build(state))

    def load_frame(self) -> None:
        """Frames are a hint for buffering."""
        self.read(8)

    dispatch: ClassVar[dict[int, Any]] = {code[0]: pickle._Unpickler.dispatch[code[0]] for code in _PLAIN} | {
        pickle.REDUCE[0]: load_reduce,
        pickle.BUILD[0]: load_build,
        pickle.FRAME[0]: load_frame,
        pickle.BYTEARRAY8[0]: pickle._Unpickler.dispatch[pickle.BINBYTES8[0]],
    }


def _describe(value: Any) -> str:
    return value.name if isinstance(value, Part) else f"a {type(value).__name__}"
