"""Compare models that the readers of MJCF and URDF make with those that MuJoCo compiles.

A program prints what the reader makes of a file, as JSON:

    cargo build --release -p physgrad-bodies --example print_model
    python bodies/tests/references/compare_models.py target/release/examples/print_model FILE...

Without files, those of Gymnasium and of the dm_control suite are compared. Every file must be equal to
1e-12 of the scale of each quantity, or refused. The exit code is 1 if a file differs, or if the program
reads a file that MuJoCo refuses. `--refused N` also demands the number of refused files.

URDF files are compared with MuJoCo's own import, from which the settings make what URDF says: fixed links
stay bodies, links without `inertial` have no mass, and meshes are left out. MuJoCo then checks the inertia
also of links that are fixed to others and refuses some files that have good sums. It makes no actuators from
URDF, so that the motors are compared with the limits of the joints.

Needs mujoco 4.0; gymnasium and dm_control for their files.
"""

import argparse
import importlib.util
import json
import pathlib
import subprocess
import sys
import xml.etree.ElementTree as ElementTree

import mujoco
import numpy as np

TOLERANCE = 1e-12
FORMS = ["plane", "hfield", "sphere", "capsule", "ellipsoid", "cylinder", "box", "mesh", "sdf"]
KINDS = ["Free", "Ball", "Slide", "Hinge"]
INTEGRATORS = ["Euler", "Rk4", None, "ImplicitFast"]


class Differences:
    """Sentences on what differs, and the largest difference that passes."""

    def __init__(self):
        self.found = []
        self.largest = 0.0

    def same(self, what, ours, theirs):
        if ours != theirs:
            self.found.append(f"{what}: {ours} and {theirs}")

    def close(self, what, ours, theirs, scale=None):
        """Compare numbers. The scale is that of the largest number, unless it is given."""
        ours, theirs = np.asarray(ours, float).ravel(), np.asarray(theirs, float).ravel()
        if ours.shape != theirs.shape:
            self.found.append(f"{what}: {ours} and {theirs}")
            return
        if not ours.size:
            return
        scale = max(np.abs(theirs).max() if scale is None else scale, 1e-300)
        difference = np.abs(ours - theirs).max() / scale
        if difference > TOLERANCE or np.isnan(difference):
            self.found.append(f"{what}: {ours} and {theirs}, difference {difference:.1e}")
        else:
            self.largest = max(self.largest, difference)


def rotation(quat):
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, np.asarray(quat, float) / np.linalg.norm(quat))
    return matrix.reshape(3, 3)


def compare_options(differences, ours, model):
    option, disabled = model.opt, mujoco.mjtDisableBit
    off = option.disableflags
    gravity = option.gravity * (not off & disabled.mjDSBL_GRAVITY)
    differences.close("timestep", ours["dt"], option.timestep)
    differences.close("gravity", ours["gravity"], gravity)
    differences.close("wind", ours["wind"], option.wind)
    differences.close("impratio", ours["impratio"], option.impratio)
    differences.close("density", ours["medium"][0], option.density)
    differences.close("viscosity", ours["medium"][1], option.viscosity)
    differences.same("integrator", ours["integrator"], INTEGRATORS[option.integrator])
    differences.same("cone", ours["cone"], ["Pyramidal", "Elliptic"][option.cone])
    constraints = not off & disabled.mjDSBL_CONSTRAINT
    contacts = constraints and not off & disabled.mjDSBL_CONTACT
    differences.same("contacts", ours["contacts"], bool(contacts))
    limits = constraints and not off & disabled.mjDSBL_LIMIT
    differences.same("limits", ours["limits"], bool(limits))


def compare_bodies(differences, ours, model):
    differences.same("number of bodies", len(ours), model.nbody)
    for i, body in enumerate(ours[: model.nbody]):
        name = f"body {body['name']}"
        if model.body(i).name:
            differences.same(f"{name} name", body["name"], model.body(i).name)
        differences.same(f"{name} parent", body["parent"], model.body_parentid[i])
        differences.close(f"{name} pos", body["pos"], model.body_pos[i])
        differences.close(f"{name} rotation", body["rotation"], rotation(model.body_quat[i]))
        differences.close(f"{name} mass", body["mass"], model.body_mass[i])
        if body["mass"] == 0.0:
            continue
        # The scale of a centre is the size of the body, which can exceed the distance of its centre.
        size = np.sqrt(model.body_inertia[i].max() / max(model.body_mass[i], 1e-300))
        scale = max(np.abs(model.body_ipos[i]).max(), size)
        differences.close(f"{name} centre", body["centre"], model.body_ipos[i], scale)
        axes = rotation(model.body_iquat[i])
        inertia = axes @ np.diag(model.body_inertia[i]) @ axes.T
        xx, yy, zz, xy, xz, yz = body["inertia"]
        matrix = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]
        differences.close(f"{name} inertia", matrix, inertia)


def compare_joints(differences, ours, model):
    differences.same("number of joints", len(ours), model.njnt)
    no_friction = model.opt.disableflags & (
        mujoco.mjtDisableBit.mjDSBL_FRICTIONLOSS | mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    )
    for i, joint in enumerate(ours[: model.njnt]):
        name = f"joint {joint['name']}"
        if model.joint(i).name:
            differences.same(f"{name} name", joint["name"], model.joint(i).name)
        kind = KINDS[model.jnt_type[i]]
        differences.same(f"{name} body", joint["body"], model.jnt_bodyid[i])
        differences.same(f"{name} kind", joint["kind"], kind)
        differences.close(f"{name} pos", joint["pos"], model.jnt_pos[i])
        address, dof = model.jnt_qposadr[i], model.jnt_dofadr[i]
        if kind in ("Hinge", "Slide"):
            differences.close(f"{name} axis", joint["axis"], model.jnt_axis[i])
            differences.close(f"{name} ref", joint["ref"], model.qpos0[address])
            differences.close(f"{name} springref", joint["springref"], model.qpos_spring[address])
        differences.close(f"{name} stiffness", joint["stiffness"], model.jnt_stiffness[i])
        differences.close(f"{name} damping", joint["damping"], model.dof_damping[dof])
        differences.close(f"{name} armature", joint["armature"], model.dof_armature[dof])
        loss = 0.0 if no_friction else model.dof_frictionloss[dof]
        differences.close(f"{name} frictionloss", joint["frictionloss"], loss)
        softness = [*model.dof_solref[dof], *model.dof_solimp[dof]]
        differences.close(f"{name} friction softness", joint["friction"], softness)
        differences.same(f"{name} limited", joint["range"] is not None, bool(model.jnt_limited[i]))
        if joint["range"] and model.jnt_limited[i]:
            differences.close(f"{name} range", joint["range"], model.jnt_range[i])
            differences.close(f"{name} margin", joint["margin"], model.jnt_margin[i])
            softness = [*model.jnt_solref[i], *model.jnt_solimp[i]]
            differences.close(f"{name} limit softness", joint["limit"], softness)
        limited = bool(model.jnt_actfrclimited[i])
        differences.same(f"{name} force limited", joint["forcerange"] is not None, limited)
        if joint["forcerange"] and limited:
            differences.close(f"{name} force range", joint["forcerange"], model.jnt_actfrcrange[i])


def compare_shapes(differences, ours, model):
    # Meshes and height fields that only are drawn are left out.
    left = [i for i in range(model.ngeom) if FORMS[model.geom_type[i]] not in ("mesh", "hfield")]
    differences.same("number of geoms", len(ours), len(left))
    for shape, i in zip(ours, left):
        name = f"geom {shape['name']}"
        if model.geom(i).name:
            differences.same(f"{name} name", shape["name"], model.geom(i).name)
        differences.same(f"{name} body", shape["body"], model.geom_bodyid[i])
        differences.same(f"{name} form", shape["form"], FORMS[model.geom_type[i]])
        size = model.geom_size[i][: len(shape["size"])]
        differences.close(f"{name} size", shape["size"], size)
        differences.close(f"{name} pos", shape["pos"], model.geom_pos[i])
        differences.close(f"{name} rotation", shape["rotation"], rotation(model.geom_quat[i]))
        for key in ("contype", "conaffinity"):
            bits = int(getattr(model, f"geom_{key}")[i]) & 0xFFFFFFFF
            differences.same(f"{name} {key}", shape[key], bits)
        for key in ("condim", "priority"):
            differences.same(f"{name} {key}", shape[key], getattr(model, f"geom_{key}")[i])
        for key in ("friction", "solmix", "margin"):
            differences.close(f"{name} {key}", shape[key], getattr(model, f"geom_{key}")[i])
        softness = [*model.geom_solref[i], *model.geom_solimp[i]]
        differences.close(f"{name} softness", shape["softness"], softness)
        colour, default = model.geom_rgba[i], np.float32([0.5, 0.5, 0.5, 1])
        if model.geom_matid[i] >= 0 and (colour == default).all():
            colour = model.mat_rgba[model.geom_matid[i]]
        # MuJoCo stores colours in single precision.
        differences.close(f"{name} rgba", np.float32(shape["rgba"]), colour)


def compare_actuators(differences, ours, model):
    differences.same("number of actuators", len(ours), model.nu)
    for i, actuator in enumerate(ours[: model.nu]):
        name = f"actuator {actuator['name']}"
        target, joints, tendon = model.actuator_trnid[i][0], actuator["joints"], int(mujoco.mjtTrn.mjTRN_TENDON)
        kinds = (tendon,) if actuator["tendon"] else (0, 1)
        differences.same(f"{name} transmission", model.actuator_trntype[i] in kinds, True)
        if actuator["tendon"]:
            first = model.tendon_adr[target]
            ends = slice(first, first + model.tendon_num[target])
            differences.same(f"{name} joints", [j for j, _ in joints], model.wrap_objid[ends].tolist())
            differences.close(f"{name} coefficients", [by for _, by in joints], model.wrap_prm[ends])
        else:
            differences.same(f"{name} joint", joints, [[target, 1.0]])
        differences.close(f"{name} gear", actuator["gear"], model.actuator_gear[i][0])
        differences.close(f"{name} gain", actuator["gain"], model.actuator_gainprm[i][0])
        bias = model.actuator_biasprm[i][:3] * (model.actuator_biastype[i] != 0)
        differences.close(f"{name} bias", actuator["bias"], bias)
        differences.same(f"{name} dynamics", 0, model.actuator_dyntype[i])
        for key, limited in (("ctrlrange", "ctrllimited"), ("forcerange", "forcelimited")):
            applies = bool(getattr(model, f"actuator_{limited}")[i])
            differences.same(f"{name} {limited}", actuator[key] is not None, applies)
            if actuator[key] and applies:
                theirs = getattr(model, f"actuator_{key}")[i]
                differences.close(f"{name} {key}", actuator[key], theirs)


def compare_rest(differences, ours, model):
    differences.same("number of sites", len(ours["sites"]), model.nsite)
    for i, site in enumerate(ours["sites"][: model.nsite]):
        differences.same(f"site {site['name']} body", site["body"], model.site_bodyid[i])
        differences.close(f"site {site['name']} pos", site["pos"], model.site_pos[i])
    # A signature is one body in the high and one in the low 16 bits, the smaller first.
    pairs = [(int(s) >> 16, int(s) & 0xFFFF) for s in model.exclude_signature]
    differences.same("excludes", sorted(tuple(sorted(p)) for p in ours["excluded"]), sorted(pairs))
    # MuJoCo appends keys in the reference pose, if the file asks for more of them.
    differences.same("keys", len(ours["poses"]) <= model.nkey, True)
    for i in range(model.nkey):
        name, positions = (ours["poses"] + [("none", model.qpos0)] * model.nkey)[i]
        theirs = model.key_qpos[i].copy()
        for joint in range(model.njnt):
            # Quaternions of both signs are one rotation.
            start = model.jnt_qposadr[joint] + 3 * (KINDS[model.jnt_type[joint]] == "Free")
            part = slice(start, start + 4)
            turns = KINDS[model.jnt_type[joint]] in ("Free", "Ball")
            if turns and np.dot(positions[part], theirs[part]) < 0:
                theirs[part] *= -1
        differences.close(f"key {name}", positions, theirs)


def compare_motors(differences, ours, model):
    """Compare the motors of a URDF file with the limits of its joints."""
    scalar = [i for i in range(model.njnt) if KINDS[model.jnt_type[i]] in ("Hinge", "Slide")]
    differences.same("motors", [a["joints"][0][0] for a in ours], scalar)
    for actuator, i in zip(ours, scalar):
        name = f"motor {actuator['name']}"
        differences.same(f"{name} name", actuator["name"], model.joint(i).name)
        law = [actuator["gear"], actuator["gain"], actuator["bias"], actuator["forcerange"]]
        differences.same(f"{name} law", law, [1.0, 1.0, [0.0] * 3, None])
        limited = bool(model.jnt_actfrclimited[i])
        theirs = list(model.jnt_actfrcrange[i]) if limited else None
        differences.same(f"{name} range", actuator["ctrlrange"], theirs)


def compare(ours, model, urdf=False):
    differences = Differences()
    compare_options(differences, ours, model)
    compare_bodies(differences, ours["bodies"], model)
    compare_joints(differences, ours["joints"], model)
    compare_shapes(differences, ours["shapes"], model)
    (compare_motors if urdf else compare_actuators)(differences, ours["actuators"], model)
    compare_rest(differences, ours, model)
    return differences


def compiled(file):
    """The model that MuJoCo compiles."""
    if file.suffix != ".urdf":
        return mujoco.MjModel.from_xml_path(str(file))
    robot = ElementTree.parse(file).getroot()
    for element in robot.findall("mujoco") + robot.findall("gazebo"):
        robot.remove(element)
    for link in robot.findall("link"):
        for shape in link.findall("collision") + link.findall("visual"):
            if shape.tag == "visual" or shape.find("geometry/mesh") is not None:
                link.remove(shape)
    settings = {"fusestatic": "false", "inertiafromgeom": "false"}
    ElementTree.SubElement(ElementTree.SubElement(robot, "mujoco"), "compiler", settings)
    return mujoco.MjModel.from_xml_string(ElementTree.tostring(robot, encoding="unicode"))


def suites():
    """Files of Gymnasium and of the dm_control suite."""
    for package, folder in (("gymnasium", "envs/mujoco/assets"), ("dm_control", "suite")):
        spec = importlib.util.find_spec(package)
        root = pathlib.Path(spec.origin).parent / folder
        yield from sorted(root.glob("*.xml"))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("program", help="prints models as JSON")
    parser.add_argument("files", nargs="*", type=pathlib.Path)
    parser.add_argument("--refused", type=int, help="number of files that must be refused")
    arguments = parser.parse_args()
    files = arguments.files or list(suites())
    run = subprocess.run([arguments.program, *files], capture_output=True, text=True, check=True)
    failed = refused = alone = 0
    for file, line in zip(files, run.stdout.splitlines(), strict=True):
        ours = json.loads(line)
        if "error" in ours:
            refused += 1
            print(f"refused  {ours['error']}")
            continue
        try:
            differences = compare(ours, compiled(file), file.suffix == ".urdf")
        except ValueError as error:
            urdf = file.suffix == ".urdf"
            failed, alone = failed + (not urdf), alone + urdf
            reason = " ".join(str(error).split())
            print(f"{'alone   ' if urdf else 'FAILED  '} {file.name}: MuJoCo refuses it: {reason}")
            continue
        if differences.found:
            failed += 1
            print(f"FAILED   {file.name}: {len(differences.found)} differences")
            for sentence in differences.found[:20]:
                print(f"         {sentence}")
        else:
            remarks = " ".join(ours["remarks"])
            print(f"equal    {file.name}, to {differences.largest:.0e}. {remarks}")
    equal = len(files) - failed - refused - alone
    print(f"{equal} of {len(files)} files equal, {refused} refused, {alone} alone, {failed} failed")
    wrong = arguments.refused is not None and arguments.refused != refused
    sys.exit(1 if failed or wrong else 0)


if __name__ == "__main__":
    main()
