"""Cancellation by signals: Ctrl-C (SIGINT), SIGTERM and SIGHUP."""

from __future__ import annotations

import signal
import sys
from types import TracebackType
from typing import Self


class Stop:
    """Raises `KeyboardInterrupt` at each stop request, and records the request; or only records it until `arm`.

    Python drops an exception raised during clean-up or in a callback from compiled code, so long work calls `check`
    from time to time.
    """

    def __init__(self, *, records_only: bool = False) -> None:
        self.wanted = False
        self.number: int = signal.SIGINT
        self.records_only = records_only
        self._before: dict[int, object] = {}
        self._hook = sys.unraisablehook

    def __enter__(self) -> Self:
        for name in ("SIGINT", "SIGTERM", "SIGHUP"):  # Windows has no SIGHUP
            number = getattr(signal, name, None)
            if number is not None and signal.getsignal(number) is not signal.SIG_IGN:  # nohup sets SIG_IGN
                self._before[number] = signal.signal(number, self._receive)
        self._hook, sys.unraisablehook = sys.unraisablehook, self._report
        return self

    def __exit__(self, _kind: type[BaseException] | None, _error: object, _trace: TracebackType | None) -> None:
        sys.unraisablehook = self._hook
        for number, handler in self._before.items():
            signal.signal(number, handler)  # type: ignore[arg-type] # the handler before

    @property
    def code(self) -> int:
        """Exit code of a process that ends by the first signal: 128 plus its number."""
        return 128 + int(self.number)

    def _receive(self, number: int, _frame: object) -> None:
        if not self.wanted:
            self.number = number
        self.wanted = True
        if not self.records_only:
            raise KeyboardInterrupt

    def _report(self, dropped: sys.UnraisableHookArgs) -> None:
        """Report an exception that Python drops, but for a request, which `check` raises again."""
        if not issubclass(dropped.exc_type, KeyboardInterrupt):
            self._hook(dropped)

    def arm(self) -> None:
        """Raise at each request from now on, and at once if one is recorded."""
        self.records_only = False
        self.check()

    def check(self) -> None:
        """Raise `KeyboardInterrupt` if a stop was requested."""
        if self.wanted:
            raise KeyboardInterrupt
