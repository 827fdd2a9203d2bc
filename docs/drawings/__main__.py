"""Write every drawing to docs/images/drawings."""

from docs.drawings import IMAGES, NAMES, drawn

IMAGES.mkdir(exist_ok=True)
for name in NAMES:
    (IMAGES / f"{name}.svg").write_text(drawn(name), encoding="utf-8")
print(f"{len(NAMES)} drawings in {IMAGES}")
