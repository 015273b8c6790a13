"""How far a command is: each long loop counts its turns, and a person is shown them where somebody asks.

This module imports only the standard library: the command line starts quickly.
"""

from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar
from typing import TypeVar

Item = TypeVar("Item")

Bar = Callable[[str, int], AbstractContextManager[Callable[[], None]]]
"""Takes what a loop does and how often; gives what is called after each turn."""

_bar: ContextVar[Bar | None] = ContextVar("contactimg_bar", default=None)


@contextmanager
def holding(variable: ContextVar[Item], value: Item) -> Iterator[None]:
    """Give a variable a value inside the block."""
    token = variable.set(value)
    try:
        yield
    finally:
        variable.reset(token)


def shown_by(bar: Bar) -> AbstractContextManager[None]:
    """Let a bar show the loops inside the block."""
    return holding(_bar, bar)


def counted(items: Iterable[Item], text: str, count: int) -> Iterator[Item]:
    """The items of a loop of ``count`` turns, each counted when the next one is asked for.

    Without a ``text``, which says what the loop does, nobody is shown it.

    Examples
    --------
    >>> @contextmanager
    ... def bar(text, count):
    ...     print(text, count)
    ...     yield lambda: print("done")
    >>> with shown_by(bar):
    ...     list(counted("a", "reading", 1))
    reading 1
    done
    ['a']
    """
    bar = _bar.get()
    if bar is None or not text:
        yield from items
        return
    with bar(text, count) as advance:
        for item in items:
            yield item
            advance()
