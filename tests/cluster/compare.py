#!/usr/bin/env python3
"""Compares two folders of a study by the SHA-256 of every file, and says what differs.

Lists of triplets are joined and sorted: there is one for each shard. Left out are flags and parts, which one process does
not write, temporary files, and TensorBoard's event files, which hold the time of day.
"""

import hashlib
import pathlib
import sys


def digest(data):
    return hashlib.sha256(data).hexdigest()


def contents(root):
    found, lists = {}, {}
    for path in sorted(root.rglob("*")):
        name = path.relative_to(root)
        left_out = name.parts[0] in ("done", "parts") or path.name.startswith((".", "events.out"))
        if not path.is_file() or left_out:
            continue
        if path.name.startswith("triplets"):
            lists.setdefault(name.parent, []).extend(path.read_text().splitlines())
        else:
            found[str(name)] = digest(path.read_bytes())
    for folder, lines in lists.items():
        found[f"{folder}/triplets*.jsonl, joined"] = digest("\n".join(sorted(lines)).encode())
    return found


def main():
    one, other = (contents(pathlib.Path(root)) for root in sys.argv[1:3])
    differing = sorted(name for name in one.keys() | other.keys() if one.get(name) != other.get(name))
    for name in differing:
        print(f"differs: {name}: {one.get(name, 'missing')[:16]} and {other.get(name, 'missing')[:16]}")
    everything = digest("\n".join(f"{name} {one[name]}" for name in sorted(one)).encode())
    print(f"{len(one)} files, {len(differing)} differ; SHA-256 of all: {everything}")
    sys.exit(bool(differing) or len(one) < 40)


main()
