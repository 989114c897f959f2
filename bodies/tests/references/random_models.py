"""Write random MJCF files, for comparisons with `compare_models.py`.

    python bodies/tests/references/random_models.py FOLDER --count 1000 --seed 1
    python bodies/tests/references/compare_models.py PROGRAM FOLDER/*.xml

The files have classes, frames, all forms, joints, notations of rotations, actuators and options at random.
Most are valid; the readers and MuJoCo may refuse the others, both for their own reasons.
"""

import argparse
import pathlib
import random

FORMS = {"sphere": 1, "capsule": 2, "cylinder": 2, "ellipsoid": 3, "box": 3}


class Writer:
    def __init__(self, seed):
        self.random = random.Random(seed)
        self.joints = []
        self.bodies = []
        self.positions = 0

    def chance(self, probability):
        return self.random.random() < probability

    def numbers(self, count, low=-1.0, high=1.0):
        return " ".join(f"{self.random.uniform(low, high):.6g}" for _ in range(count))

    def maybe(self, probability, name, value):
        """An attribute, or nothing."""
        return f' {name}="{value()}"' if self.chance(probability) else ""

    def ordered(self, low=-2.0, high=2.0):
        return " ".join(f"{x:.6g}" for x in sorted(self.random.uniform(low, high) for _ in range(2)))

    def rotation(self, probability):
        kinds = {"quat": 4, "axisangle": 4, "euler": 3, "xyaxes": 6, "zaxis": 3}
        kind = self.random.choice(list(kinds))
        scale = 90 if kind == "euler" else 1
        return self.maybe(probability, kind, lambda: self.numbers(kinds[kind], -scale, scale))

    def softness(self, reference, impedance):
        count = self.random.choice([0, 1])
        text = self.maybe(0.2, reference, lambda: self.numbers(1 + count, 0.01, 1))
        impedances = lambda: f"{self.ordered(0.01, 0.99)} {self.numbers(count, 0.001, 0.1)}"
        return text + self.maybe(0.2, impedance, impedances)

    def joint(self, in_class=False):
        kind = self.random.choice(["hinge", "hinge", "slide"])
        text = "" if in_class else self.maybe(0.8, "type", lambda: kind)
        for name, count, low, high in (
            ("pos", 3, -1, 1),
            ("axis", 3, -1, 1),
            ("ref", 1, -9, 9),
            ("springref", 1, -9, 9),
            ("stiffness", 1, 0, 9),
            ("damping", 1, 0, 9),
            ("armature", 1, 0, 1),
            ("frictionloss", 1, 0, 1),
            ("margin", 1, 0, 0.1),
        ):
            text += self.maybe(0.2, name, lambda: self.numbers(count, low, high))
        text += self.maybe(0.3, "range", self.ordered)
        text += self.maybe(0.1, "actuatorfrcrange", self.ordered)
        text += self.maybe(0.1, "limited", lambda: self.random.choice(["false", "auto"]))
        text += self.softness("solreflimit", "solimplimit")
        return text + self.softness("solreffriction", "solimpfriction")

    def geom(self, in_class=False):
        text = ""
        if not in_class:
            form = self.random.choice(list(FORMS))
            text += f' type="{form}"'
            if form != "sphere" and self.chance(0.3):
                text += f' size="{self.numbers(1, 0.05, 0.5)}" fromto="{self.numbers(6)}"'
            else:
                text += f' size="{self.numbers(FORMS[form], 0.05, 0.5)}"'
                text += self.maybe(0.7, "pos", lambda: self.numbers(3)) + self.rotation(0.5)
        text += self.maybe(0.2, "mass", lambda: self.numbers(1, 0.1, 2))
        text += self.maybe(0.3, "density", lambda: self.numbers(1, 100, 2000))
        text += self.maybe(0.3, "friction", lambda: self.numbers(self.random.choice([1, 2, 3]), 0, 1))
        text += self.maybe(0.2, "condim", lambda: self.random.choice([1, 3, 4, 6]))
        text += self.maybe(0.2, "group", lambda: self.random.randint(0, 6))
        for name in ("contype", "conaffinity", "priority"):
            text += self.maybe(0.1, name, lambda: self.random.randint(-3, 9))
        for name in ("solmix", "margin", "gap"):
            text += self.maybe(0.1, name, lambda: self.numbers(1, 0, 1))
        text += self.maybe(0.1, "rgba", lambda: self.numbers(4, 0, 1))
        text += self.maybe(0.1, "material", lambda: "red")
        return text + self.softness("solref", "solimp")

    def actuator_law(self, kind, in_class=False):
        text = self.maybe(0.3, "gear", lambda: self.numbers(1, -3, 3))
        for name, limited in (("ctrlrange", "ctrllimited"), ("forcerange", "forcelimited")):
            text += self.maybe(0.3, name, self.ordered) + self.maybe(0.1, limited, lambda: "false")
        if kind == "position":
            text += self.maybe(0.6, "kp", lambda: self.numbers(1, 0, 9))
        if kind in ("position", "velocity"):
            text += self.maybe(0.6, "kv", lambda: self.numbers(1, 0, 9))
        if kind == "general":
            text += self.maybe(0.5, "gainprm", lambda: self.numbers(1, -9, 9))
            text += self.maybe(0.5, "biasprm", lambda: self.numbers(self.random.choice([1, 2, 3]), -9, 0))
            text += self.maybe(0.5, "biastype", lambda: self.random.choice(["affine", "none"]))
        return text

    def classes(self, names):
        """Nested classes of these names."""
        text = f"<joint{self.joint(True)}/><geom{self.geom(True)}/>" if self.chance(0.7) else ""
        for kind in self.random.sample(["motor", "position", "velocity", "general"], 2):
            text += f"<{kind}{self.actuator_law(kind, True)}/>" if self.chance(0.4) else ""
        if names:
            text += f'<default class="{names[0]}">{self.classes(names[1:])}</default>'
        return text

    def cls(self):
        return self.maybe(0.3, "class", lambda: self.random.choice("abc"))

    def childclass(self):
        return self.maybe(0.2, "childclass", lambda: self.random.choice("abc"))

    def inertial(self):
        a, b = self.random.uniform(0.1, 1), self.random.uniform(0.1, 1)
        text = f'<inertial pos="{self.numbers(3)}" mass="{self.numbers(1, 0.1, 2)}"'
        if self.chance(0.3):
            return text + f' fullinertia="{a + 1} {b + 1} {1.3} {self.numbers(3, -0.05, 0.05)}"/>'
        return text + f'{self.rotation(0.5)} diaginertia="{a} {b} {0.9 * (a + b)}"/>'

    def body(self, depth):
        name = f"body{len(self.bodies)}"
        self.bodies.append(name)
        text = f'<body name="{name}"{self.childclass()}{self.maybe(0.8, "pos", lambda: self.numbers(3))}'
        text += self.rotation(0.4) + ">"
        if depth == 0 and self.chance(0.3):
            text += "<freejoint/>"
            self.positions += 7
        elif self.chance(0.1):
            text += f'<joint type="ball" limited="false" damping="{self.numbers(1, 0, 1)}"/>'
            self.positions += 4
        else:
            for _ in range(self.random.choice([0, 1, 1, 2])):
                joint = f"joint{len(self.joints)}"
                self.joints.append(joint)
                self.positions += 1
                text += f'<joint name="{joint}"{self.cls()}{self.joint()}/>'
        inner = self.inertial() if self.chance(0.3) else ""
        inner += "".join(f"<geom{self.cls()}{self.geom()}/>" for _ in range(self.random.randint(1, 3)))
        inner += f'<site pos="{self.numbers(3)}"/>' if self.chance(0.3) else ""
        if self.chance(0.2):
            pose = self.maybe(0.8, "pos", lambda: self.numbers(3)) + self.rotation(0.6)
            inner = f"<frame{self.childclass()}{pose}>{inner}</frame>"
        text += inner
        for _ in range(self.random.choice([0, 1, 1, 2]) if depth < 4 else 0):
            text += self.body(depth + 1)
        return text + "</body>"

    def compiler(self):
        text = self.maybe(0.5, "angle", lambda: self.random.choice(["radian", "degree"]))
        letters = lambda: "".join(self.random.choice("xyzXYZ") for _ in range(3))
        text += self.maybe(0.4, "eulerseq", letters)
        text += self.maybe(0.3, "inertiafromgeom", lambda: self.random.choice(["true", "auto"]))
        text += self.maybe(0.2, "settotalmass", lambda: self.numbers(1, 1, 9))
        text += self.maybe(0.2, "boundmass", lambda: self.numbers(1, 0, 9))
        text += self.maybe(0.2, "boundinertia", lambda: self.numbers(1, 0, 9))
        text += self.maybe(0.3, "balanceinertia", lambda: "true")
        return text + self.maybe(0.2, "inertiagrouprange", lambda: f"0 {self.random.randint(3, 6)}")

    def option(self):
        text = self.maybe(0.5, "gravity", lambda: self.numbers(3))
        text += self.maybe(0.3, "wind", lambda: self.numbers(3))
        integrators = ["Euler", "RK4", "implicitfast"]
        return text + self.maybe(0.5, "integrator", lambda: self.random.choice(integrators))

    def actuator(self, joint):
        kind = self.random.choice(["motor", "position", "velocity", "general"])
        return f'<{kind} {joint}{self.cls()}{self.actuator_law(kind)}/>'

    def tendon(self, name):
        joints = self.random.sample(self.joints, min(len(self.joints), self.random.randint(1, 4)))
        ends = "".join(f'<joint joint="{joint}" coef="{self.numbers(1)}"/>' for joint in joints)
        return f'<fixed name="{name}">{ends}</fixed>'

    def model(self):
        classes = self.classes(list("abc"))
        world = f'<geom type="plane" size="1 1 1"/>{self.body(0)}{self.body(0)}'
        tendons = [f"t{i}" for i in range(self.random.choice([0, 0, 1, 3]) if self.joints else 0)]
        actuators = [f'joint="{joint}"' for joint in self.joints] + [f'tendon="{name}"' for name in tendons]
        actuators = "".join(map(self.actuator, actuators))
        a, b = self.random.sample(self.bodies, 2)
        key = f'<key qpos="{self.numbers(self.positions)}"/><key/>'
        sections = {
            "default": classes,
            "asset": '<material name="red" rgba="1 0 0 1"/>',
            "worldbody": world,
            "tendon": "".join(map(self.tendon, tendons)),
            "contact": f'<exclude body1="{a}" body2="{b}"/>',
            "actuator": actuators,
            "keyframe": key,
        }
        text = f"<compiler{self.compiler()}/><option{self.option()}/>"
        text += "".join(f"<{name}>{content}</{name}>" for name, content in sections.items())
        return f"<mujoco>{text}</mujoco>\n"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=pathlib.Path)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    arguments.folder.mkdir(parents=True, exist_ok=True)
    for i in range(arguments.count):
        text = Writer(arguments.seed * 1_000_003 + i).model().replace("><", ">\n<")
        (arguments.folder / f"random{i:05}.xml").write_text(text)


if __name__ == "__main__":
    main()
