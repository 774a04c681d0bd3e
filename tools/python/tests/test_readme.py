"""The README shows the example that CI runs."""

import re

from conftest import ASSETS


def test_the_lines_in_the_readme_are_those_of_the_example():
    root = ASSETS.parent
    [shown] = re.findall(r"```python\n(.*?)```", (root / "README.md").read_text(encoding="utf-8"), re.DOTALL)
    example = (root / "tools/python/examples/force_map.py").read_text(encoding="utf-8")
    assert example.split('"""')[2].strip() == shown.strip()
