"""A reader of plain data out of pickle files that cannot run code, import anything, or use much memory.

Python's own unpickler calls whatever a file asks for. This one is a separate, small machine: it knows lists, tuples,
text, bytes, integers and a few named parts that the caller declares, and nothing else exists for it. A call in the
file (REDUCE, BUILD) is looked up among those parts and otherwise refused.

Memory: the list at the top is handed out piece by piece; lists inside it hold integers only, tuples nest at most twice,
only short things can be referred to again, and nothing has more than `MAX_ITEMS` items. So what a file describes takes
no more memory than the file itself, whatever it says.
"""

import codecs
import re
from collections.abc import Callable, Iterator
from typing import Any

MAX_ITEMS = 100_000
"""Most items on the stack or in one list: longer than any episode of a BabyAI level."""

Buffer = Any  # bytes or mmap
_BYTE_INTEGERS = re.compile(rb"(?:K[\s\S])+")  # runs of BININT1, which is what directions are stored as
_BYTE_MEMOS = re.compile(rb"(?:h[\s\S])+")  # runs of BINGET, which is what actions are stored as
_MARK = object()
_FORGOTTEN = object()  # a memo entry that was not kept
_LONGEST_RECALLED = 300  # the longest BabyAI instruction has 183 characters


class PickleRefusedError(ValueError):
    """The file holds something that plain data does not need, or is damaged."""


class Part:
    """A name that a file may refer to, with what it means to call it or to give it a state.

    Nothing in a file can change a part: both meanings are functions of this package that return something new.
    """

    __slots__ = ("_build", "_call", "name")

    def __init__(
        self, name: str, call: Callable[..., Any] | None = None, build: Callable[[Any], Any] | None = None
    ) -> None:
        self.name, self._call, self._build = name, call, build

    def called(self, arguments: tuple) -> Any:
        """Result of a REDUCE of this part: `call(*arguments)`, a function of this package."""
        if self._call is None:
            raise PickleRefusedError(f"it calls {self.name}, which is refused")
        try:
            return self._call(*arguments)
        except TypeError as error:
            raise PickleRefusedError(f"it calls {self.name} with unexpected arguments") from error

    def built(self, state: Any) -> Any:
        """Result of a BUILD of this part with `state`."""
        if self._build is None:
            raise PickleRefusedError(f"it changes {self.name}, which is refused")
        return self._build(state)


Parts = dict[tuple[str, str], Part]


def read_items(data: Buffer, parts: Parts) -> Iterator[Any]:
    """Yield the items of the list that a pickle holds, without ever holding the list.

    Raises:
        PickleRefusedError: at the first thing that is refused; items before it have been yielded.
    """
    yield from _Machine(data, parts, stream=True).run()


def read_value(data: Buffer, parts: Parts) -> Any:
    """The one value that a pickle holds; raises `PickleRefusedError` if anything in it is refused."""
    machine = _Machine(data, parts, stream=False)
    for _ in machine.run():
        pass
    return machine.result


class _Machine:
    """State of one reading. Opcodes: see the standard library's `pickletools`."""

    def __init__(self, data: Buffer, parts: Parts, stream: bool) -> None:
        self.data, self.parts, self.stream = data, parts, stream
        self.at, self.end = 0, len(data)
        self.stack: list[Any] = []
        self.memo: dict[int, Any] = {}
        self.memoized = 0
        self.top: list[Any] | None = None
        self.result: Any = None

    def run(self) -> Iterator[Any]:
        data, end, operations = self.data, self.end, _OPERATIONS
        while self.at < end:
            code = data[self.at]
            self.at += 1
            if code == 0x2E:  # STOP
                yield from self.stop()
                return
            operation = operations[code]
            if operation is None:
                raise PickleRefusedError(f"it uses pickle operation {bytes([code])!r}, which plain data does not need")
            operation(self)
            if len(self.stack) > MAX_ITEMS:
                raise PickleRefusedError(f"it nests more than {MAX_ITEMS:,} items")
            if self.top:
                yield from self.top
                self.top.clear()
        raise PickleRefusedError("it ends too early (truncated?)")

    def stop(self) -> Iterator[Any]:
        self.result = self.pop()
        if self.stack:
            raise PickleRefusedError("it ends with parts left over")
        if self.stream and self.result is not self.top:
            raise PickleRefusedError(f"it holds {_describe(self.result)}; expected a list of demonstrations")
        yield from ()

    def take(self, count: int) -> bytes:
        """The next `count` bytes."""
        start, self.at = self.at, self.at + count
        if self.at > self.end:
            raise PickleRefusedError("it ends too early (truncated?)")
        return self.data[start : self.at]

    def line(self) -> bytes:
        """The rest of a text line, without its newline."""
        newline = self.data.find(b"\n", self.at)
        if newline < 0:
            raise PickleRefusedError("it ends too early (truncated?)")
        line = self.data[self.at : newline]
        self.at = newline + 1
        return line

    def unsigned(self, count: int) -> int:
        return int.from_bytes(self.take(count), "little")

    def signed(self, count: int) -> int:
        return int.from_bytes(self.take(count), "little", signed=True)

    def push(self, value: Any) -> None:
        self.stack.append(value)

    def pop(self) -> Any:
        if not self.stack or self.stack[-1] is _MARK:
            raise PickleRefusedError("it is damaged (nothing to take from the stack)")
        return self.stack.pop()

    def pop_to_mark(self) -> list[Any]:
        stack = self.stack
        for depth in range(len(stack) - 1, -1, -1):
            if stack[depth] is _MARK:
                items = stack[depth + 1 :]
                del stack[depth:]
                return items
        raise PickleRefusedError("it is damaged (no mark on the stack)")

    def new_list(self, items: list[Any]) -> None:
        if self.stream and self.top is None:
            self.top = items
        self.check_list_items(items, items)
        self.push(items)

    def new_tuple(self, items: list[Any]) -> None:
        for item in items:
            if type(item) is tuple and not {*map(type, item)}.isdisjoint((tuple, list)):
                raise PickleRefusedError("it nests tuples more deeply than demonstrations do")
        self.push(tuple(items))

    def extend(self, items: list[Any]) -> None:
        """Append to the list on top of the stack."""
        target = self.stack[-1] if self.stack else None
        if type(target) is not list or len(target) + len(items) > MAX_ITEMS:
            raise PickleRefusedError(f"it appends to {_describe(target)}, or more than {MAX_ITEMS:,} items")
        self.check_list_items(target, items)
        target.extend(items)

    def check_list_items(self, target: list[Any], items: list[Any]) -> None:
        if target is not self.top and not {*map(type, items)} <= {int}:
            raise PickleRefusedError("it holds a list of something else than integers")

    def put(self, index: int) -> None:
        """Remember the top of the stack, unless it is large: only names, numbers and short text recur."""
        if not self.stack or self.stack[-1] is _MARK:
            raise PickleRefusedError("it is damaged (nothing to remember)")
        value = self.stack[-1]
        self.memoized += 1
        if isinstance(value, (Part, int)) or (isinstance(value, (str, bytes)) and len(value) <= _LONGEST_RECALLED):
            self.memo[index] = value
        else:
            self.memo.pop(index, None)

    def get(self, index: int) -> None:
        value = self.memo.get(index, _FORGOTTEN)
        if value is _FORGOTTEN:
            raise PickleRefusedError("it refers to a collection twice, which demonstrations do not")
        self.push(value)

    def part(self, module: Any, name: Any) -> None:
        if type(module) is not str or type(name) is not str:
            raise PickleRefusedError("it is damaged (a name that is not text)")
        found = self.parts.get((module, name))
        if found is None:
            raise PickleRefusedError(f"it refers to {module}.{name}, which is refused")
        self.push(found)

    def call(self) -> None:
        arguments, function = self.pop(), self.pop()
        if not isinstance(function, Part) or type(arguments) is not tuple:
            raise PickleRefusedError(f"it calls {_describe(function)}, which is refused")
        self.push(function.called(arguments))

    def build(self) -> None:
        """BUILD gives a state to an object: here it makes a new object, and only of a `Part` that knows how."""
        state, target = self.pop(), self.pop()
        if not isinstance(target, Part):
            raise PickleRefusedError(f"it changes {_describe(target)}, which is refused")
        self.push(target.built(state))

    def tuple_of(self, count: int) -> None:
        self.new_tuple([self.pop() for _ in range(count)][::-1])

    def byte_integers(self) -> None:
        """All BININT1 in a row at once."""
        run = _BYTE_INTEGERS.match(self.data, self.at - 1, min(self.end, self.at + 2 * MAX_ITEMS))
        if run is None:
            raise PickleRefusedError("it ends too early (truncated?)")
        self.at = run.end()
        self.stack.extend(run.group()[1::2])

    def byte_memos(self) -> None:
        """All BINGET in a row at once."""
        run = _BYTE_MEMOS.match(self.data, self.at - 1, min(self.end, self.at + 2 * MAX_ITEMS))
        if run is None:
            raise PickleRefusedError("it ends too early (truncated?)")
        self.at = run.end()
        for index in run.group()[1::2]:
            self.get(index)

    def text_integer(self) -> None:
        """INT of protocol 0; `00` and `01` are its booleans."""
        line = self.line()
        self.push(line == b"01" if line in (b"00", b"01") else _integer(line))

    def text_global(self) -> None:
        self.part(_text(self.line(), "utf-8"), _text(self.line(), "utf-8"))

    def stack_global(self) -> None:
        name, module = self.pop(), self.pop()
        self.part(module, name)

    def text_string(self) -> None:
        """STRING of python 2, a quoted literal: kept as latin-1 text."""
        line = self.line().strip()
        if len(line) < 2 or line[:1] not in (b"'", b'"') or line[:1] != line[-1:]:
            raise PickleRefusedError("it is damaged (a string without quotes)")
        try:
            self.push(codecs.escape_decode(line[1:-1])[0].decode("latin-1"))
        except ValueError as error:
            raise PickleRefusedError("it is damaged (a bad escape in a string)") from error


def _integer(line: bytes) -> int:
    try:
        return int(line.rstrip(b"L"))  # Python itself refuses more than 4300 digits
    except ValueError as error:
        raise PickleRefusedError("it is damaged (a bad number)") from error


def _text(raw: bytes, encoding: str) -> str:
    try:
        return str(raw, encoding, "surrogatepass" if encoding == "utf-8" else "strict")
    except UnicodeDecodeError as error:
        raise PickleRefusedError("it is damaged (text that is not text)") from error


def _describe(value: Any) -> str:
    return value.name if isinstance(value, Part) else f"a {type(value).__name__}"


_Operation = Callable[[_Machine], Any]


def _operations() -> list[_Operation | None]:
    """Operation per opcode byte. What is absent is refused: INST, OBJ, NEWOBJ, dictionaries, sets, persistent ids..."""
    table: dict[bytes, _Operation] = {
        b"\x80": lambda m: m.take(1),  # PROTO
        b"\x95": lambda m: m.take(8),  # FRAME: only a hint for buffering
        b"(": lambda m: m.push(_MARK),
        b"]": lambda m: m.new_list([]),
        b"l": lambda m: m.new_list(m.pop_to_mark()),
        b"a": lambda m: m.extend([m.pop()]),
        b"e": lambda m: m.extend(m.pop_to_mark()),
        b")": lambda m: m.push(()),
        b"t": lambda m: m.new_tuple(m.pop_to_mark()),
        b"\x85": lambda m: m.tuple_of(1),
        b"\x86": lambda m: m.tuple_of(2),
        b"\x87": lambda m: m.tuple_of(3),
        b"N": lambda m: m.push(None),
        b"\x88": lambda m: m.push(True),
        b"\x89": lambda m: m.push(False),
        b"K": lambda m: m.byte_integers(),
        b"M": lambda m: m.push(m.unsigned(2)),
        b"J": lambda m: m.push(m.signed(4)),
        b"\x8a": lambda m: m.push(m.signed(m.unsigned(1))),  # LONG1
        b"I": lambda m: m.text_integer(),
        b"L": lambda m: m.push(_integer(m.line())),
        b"V": lambda m: m.push(_text(m.line(), "raw-unicode-escape")),
        b"X": lambda m: m.push(_text(m.take(m.unsigned(4)), "utf-8")),
        b"\x8c": lambda m: m.push(_text(m.take(m.unsigned(1)), "utf-8")),
        b"\x8d": lambda m: m.push(_text(m.take(m.unsigned(8)), "utf-8")),
        b"S": lambda m: m.text_string(),
        b"T": lambda m: m.push(_text(m.take(m.unsigned(4)), "latin-1")),  # python 2: bytes, kept as latin-1 text
        b"U": lambda m: m.push(_text(m.take(m.unsigned(1)), "latin-1")),
        b"B": lambda m: m.push(bytes(m.take(m.unsigned(4)))),
        b"C": lambda m: m.push(bytes(m.take(m.unsigned(1)))),
        b"\x8e": lambda m: m.push(bytes(m.take(m.unsigned(8)))),
        b"\x96": lambda m: m.push(bytes(m.take(m.unsigned(8)))),  # BYTEARRAY8
        b"p": lambda m: m.put(_integer(m.line())),
        b"q": lambda m: m.put(m.unsigned(1)),
        b"r": lambda m: m.put(m.unsigned(4)),
        b"\x94": lambda m: m.put(m.memoized),  # MEMOIZE
        b"g": lambda m: m.get(_integer(m.line())),
        b"h": lambda m: m.byte_memos(),
        b"j": lambda m: m.get(m.unsigned(4)),
        b"0": lambda m: m.pop(),
        b"c": lambda m: m.text_global(),
        b"\x93": lambda m: m.stack_global(),
        b"R": lambda m: m.call(),
        b"b": lambda m: m.build(),
    }
    return [table.get(bytes([code])) for code in range(256)]


_OPERATIONS = _operations()
