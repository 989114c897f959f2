"""Settings of a task as a dict that refuses changes."""

from __future__ import annotations

from typing import Any, NoReturn


class Settings(dict[str, Any]):
    """A dict that refuses changes: a task does not change. Copies are ordinary dicts."""

    def _refuse(self, *_: Any, **__: Any) -> NoReturn:
        raise TypeError("the settings of a task do not change; `task.replace` returns a task with other settings")

    __setitem__ = __delitem__ = __ior__ = clear = pop = popitem = setdefault = update = _refuse

    def __reduce__(self) -> tuple[type, tuple[dict[str, Any]]]:
        return dict, (dict(self),)
