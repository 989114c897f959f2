#!/usr/bin/env python3
"""Multiplies every constant of the physics by 1.1, one at a time. Prints the mutations that
`tests/physics` does not detect.

    python3 tests/mutations/mutate.py [--list] [--factor 1.1] [--only EXPRESSION]

The script inserts a factor of 1 at every place in a copy of the sources. The environment variable
MUTATION selects the place whose factor differs. All mutations share one build.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
# Names of files without physics: dispatch, limits of settings, and solvers.
WITHOUT = {"masses.rs", "model.rs", "scheme.rs", "loss.rs", "riccati.rs", "factor.rs"}
# Names of build products, which are not copied.
PRODUCTS = shutil.ignore_patterns("*.so", "__pycache__", ".pytest_cache")
# Patterns of local variables that hold constants, per file.
NAMED = {
    "double_pendulum.rs": r"(?:m1|m2|l1|l2)\b(?=\s*[-+*/)])",
    "contact.rs": r"(?:stiffness|damping)\b(?=\s*[/)])",
    "impact.rs": r"(?<=T::from\()restitution\b",
    "pair.rs": r"(?:total|first)\b(?=\s*[*/)])",
    "absorbing.rs": r"(?:width|strength)\b(?=\s*[-*;])",
    "lqr.rs": r"(?:stiffness|damping)\b(?=[,)])",
    "coupled.rs": r"(?<=T::from\()moment\b|moment\b(?=\s*\* model)",
    "system.rs": r"(?<=T::from\()moment\b|moment\b(?= [*/])",
}
LIBRARY = """
#[doc(hidden)]
pub mod mutation {
    static CHOSEN: std::sync::LazyLock<usize> =
        std::sync::LazyLock::new(|| std::env::var("MUTATION").ok().and_then(|at| at.parse().ok()).unwrap_or(usize::MAX));
    #[inline(never)]
    pub fn by(at: usize) -> f64 {
        if *CHOSEN == at { FACTOR } else { 1.0 }
    }
}
"""


def fields(text):
    """Returns three sets of names: public fields of type f64 or Number, all fields of these types,
    and fields of type usize.
    """
    names = lambda pattern: set(re.findall(pattern, text, re.M))
    return names(r"^\s*pub (\w+): (?:f64|Number),"), names(r"^\s*(?:pub )?(\w+): (?:f64|Number),"), names(r"^\s*(?:pub )?(\w+): usize,")


def places(name, everywhere, own):
    """Returns the pattern of the constants in a file.

    `own` contains the names of all fields of type f64 or Number in this file. `everywhere` contains
    the names of the public fields of these types in all files. It lacks names that a field of type
    usize also has.
    """
    any_of = lambda names: "|".join(sorted(names, key=len, reverse=True)) or "!"
    of_self = r"self\.(?:%s)" % any_of(own)
    of_others = r"(?:self\.(?:0|system|system\.system)|model|law)\.(?:%s)" % any_of(everywhere)
    value = r"(?<![\w.&])(?:%s|%s)\b(?!\s*[\(\[=])" % (of_self, of_others)
    number = r"(?<![\w.])(?!0\.0\b)\d+\.\d+(?:e-?\d+)?(?![\w.]*f32)(?!\d)"
    constant = r"(?<![\w:])(?:GRAVITY|PI|TAU)\b"
    found = [value, number, constant]
    if name in NAMED:
        found.append(r"(?<![\w.])(?:%s)" % NAMED[name])
    return re.compile("|".join("(?:%s)" % pattern for pattern in found))


def mutate(folder):
    """Adds a factor to every constant. Returns the places of the constants."""
    files = sorted(folder.glob("src/tasks/**/*.rs")) + [folder / "src/dynamics/actuator/kinds.rs"]
    files = [file for file in files if file.name not in WITHOUT]
    texts = {file: file.read_text() for file in files}
    everywhere, _, counts = (set().union(*sets) for sets in zip(*map(fields, texts.values())))
    found = []
    for file, text in texts.items():
        pattern = places(file.name, everywhere - counts, fields(text)[1])
        one = file.name not in ("gap.rs", "impact.rs")
        lines = []
        for number, line in enumerate(text.split("\n"), 1):
            bare = line.strip()
            if bare.startswith(("//", "#", "use ", "const ", "pub const ", "pub fn", "fn ", "impl")) or '"' in line:
                lines.append(line)
                continue

            def factor(match, template="({} * crate::mutation::by({}))"):
                # Skips a name that `let` binds.
                if re.match(r"\s*let\b[^=]*$", line[: match.start()]):
                    return match.group(0)
                found.append((file.relative_to(folder), number, match.group(0), bare))
                return template.format(match.group(0), len(found) - 1)

            line = pattern.sub(factor, line)
            if one:
                line = re.sub(r"\b[TR]::one\(\)", lambda m: factor(m, m.group(0)[0] + "::from(crate::mutation::by({1}))"), line)
            lines.append(line)
        file.write_text("\n".join(lines))
    return found


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--list", action="store_true", help="list the places and stop")
    parser.add_argument("--factor", default="1.1")
    parser.add_argument("--only", default="", help="a regular expression for FILE:LINE")
    parser.add_argument("--target", default=str(ROOT / "target/mutations"), help="folder to build in")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        # Cargo also requires the other members of the workspace.
        for name in ["Cargo.toml", "Cargo.lock", "src", "tests", "benches", "examples", "docs", "plot", "cli", "python", "README.md"]:
            source = ROOT / name
            if source.is_dir():
                shutil.copytree(source, folder / name, ignore=PRODUCTS)
            else:
                shutil.copy(source, folder / name)
        found = mutate(folder)
        chosen = [i for i, place in enumerate(found) if re.search(args.only, "%s:%s" % place[:2])]
        if args.list:
            for i in chosen:
                print(i, *found[i])
            return
        library = folder / "src/lib.rs"
        library.write_text(library.read_text() + LIBRARY.replace("FACTOR", args.factor))
        build = ["cargo", "test", "-p", "physgrad-tests", "--test", "simulations", "--no-run"]
        environment = {**os.environ, "CARGO_TARGET_DIR": args.target, "CARGO_PROFILE_DEV_DEBUG": "0"}
        built = subprocess.run(build, cwd=folder, env=environment, stderr=subprocess.PIPE, text=True)
        program = re.search(r"\((\S*deps/simulations-\w+)\)", built.stderr)
        if built.returncode != 0 or not program:
            sys.exit(built.stderr)

        def fails(at):
            environment = {**os.environ, "MUTATION": str(at), "RUST_BACKTRACE": "0"}
            try:
                run = subprocess.run([folder / program[1], "-q", "physics::"], env=environment, capture_output=True, timeout=300)
            except subprocess.TimeoutExpired:
                return True
            return run.returncode != 0

        if fails(len(found)):
            sys.exit("tests/physics fails without a mutation")
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            killed = dict(zip(chosen, pool.map(fails, chosen)))
        survived = [at for at in chosen if not killed[at]]
        for at in survived:
            path, number, what, line = found[at]
            print(f"survived: {path}:{number}: {what} in `{line}`")
        print(f"{len(chosen)} mutations, {len(chosen) - len(survived)} killed, {len(survived)} survived")


main()
