"""Write docs/settings.md from the settings themselves: `python -m scripts.document_settings`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from common.config.faults import PREFIX
from common.config.kinds import written
from common.config.presets import default_settings
from common.config.settings import RunSettings, Section
from common.config.tree import value_of

PAGE = Path(__file__).parent.parent / "docs" / "settings.md"

HEAD = f"""\
# Settings

Made by `python -m scripts.document_settings`; a test holds it against the code.

A setting `algorithm.gamma` is `--algorithm.gamma 0.995` on the command line, `{PREFIX}ALGORITHM__GAMMA=0.995` in the
environment, and in the file given by `--config`:

```yaml
algorithm:
  gamma: 0.995
```

These sources come in this order, and the defaults last: the first source that sets a value takes precedence. Whole
numbers may be written as `3e6`, and lists as `256,256` (or `[256, 256]`) in all of them.

The defaults below are `reskpn/presets/default.yaml`'s; with a `learner` other than `reskpn`, `algorithm.objective` is
`auto`, and everything of `rkhs` and `critic` as in the paper. `--config paper` takes the paper's Table 1
(`reskpn/presets/paper.yaml`).
"""


def page() -> str:
    """The whole page."""
    parts = [HEAD, _table("The run", RunSettings, "")]
    for name, field in RunSettings.model_fields.items():
        if isinstance(field.default, Section):
            parts.append(_table(f"`{name}`", type(field.default), f"{name}."))
    return "\n".join(parts)


def _table(title: str, section: type[Section], prefix: str) -> str:
    text = " ".join((section.__doc__ or "").split())
    rows = [
        f"| `{prefix}{name}` | {_default(value_of(default_settings(), prefix + name))} | {field.description} |"
        for name, field in section.model_fields.items()
        if not isinstance(field.default, Section)
    ]
    return "\n".join([f"## {title}", "", text, "", "| setting | default | meaning |", "| --- | --- | --- |", *rows, ""])


def _default(value: Any) -> str:
    text = (
        f"{value:,}" if isinstance(value, int) and not isinstance(value, bool) and value >= 10_000 else written(value)
    )
    return f"`{text}`" if text else "-"


if __name__ == "__main__":
    PAGE.write_text(page())
