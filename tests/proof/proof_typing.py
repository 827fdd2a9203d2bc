"""Entries typed by hand into the workbench: none may change. Oracle: the text that was typed.

Run from the root of the repository: python tests/proof/proof_typing.py [entries] [seed]
"""

import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "support"))
sys.path.insert(0, str(Path(__file__).parents[1] / "web"))

from playwright.sync_api import sync_playwright
from test_web_page import typed_by_hand

from workbench_page import Bench, chromium, serving


def main(cases=30, seed=1):
    """Type `cases` entries, 70 to 220 ms a key, on a computer slowed down four times; return how many changed."""
    with (
        tempfile.TemporaryDirectory() as folder,
        sync_playwright() as playwright,
        chromium(playwright) as chrome,
        serving(folder) as address,
    ):
        one = Bench(chrome, address).open()
        one.page.locator("#welcome .examples button").filter(has_text="infrared").first.click()
        one.page.locator("#field-tool-nose_radius").wait_for()
        one.context.new_cdp_session(one.page).send("Emulation.setCPUThrottlingRate", {"rate": 4})
        changed = typed_by_hand(one, cases, seed=seed)
    print(f"{cases} entries typed at 70 to 220 ms a key, seed {seed}: {len(changed)} changed")
    for name, typed, shown in changed:
        print(f"  {name}: typed {typed!r}, shown {shown!r}")
    return len(changed)


if __name__ == "__main__":
    sys.exit(1 if main(*map(int, sys.argv[1:])) else 0)
