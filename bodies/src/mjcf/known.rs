//! Attributes of the elements of MJCF: read, without effect here, or refused.

use super::view::Known;

/// Actuators that are read.
pub(crate) const ACTUATORS: [&str; 4] = ["general", "motor", "position", "velocity"];

/// Actuators that are refused.
pub(crate) const OTHER_ACTUATORS: [&str; 10] = [
    "intvelocity",
    "orientation",
    "pid",
    "damper",
    "cylinder",
    "muscle",
    "adhesion",
    "dcmotor",
    "plugin",
    "user",
];

pub(crate) const ROOT: Known = Known { read: &["model"], ignored: &[], refused: &[] };

pub(crate) const COMPILER: Known = Known {
    read: &[
        "angle",
        "autolimits",
        "eulerseq",
        "inertiafromgeom",
        "inertiagrouprange",
        "settotalmass",
        "boundmass",
        "boundinertia",
        "balanceinertia",
    ],
    ignored: &[
        "assetdir",
        "meshdir",
        "texturedir",
        "conflict",
        "discardvisual",
        "fitaabb",
        "passthrough",
        "savecanonical",
        "savecompiled",
        "saveinertial",
        "strippath",
        "usethread",
        "convexhull",
        "exactmeshinertia",
    ],
    refused: &[
        ("coordinate", "local", "convert the file to local coordinates"),
        ("fusestatic", "false", "set it to false"),
        ("alignfree", "false", "set it to false"),
    ],
};

pub(crate) const OPTION: Known = Known {
    read: &[
        "timestep",
        "gravity",
        "integrator",
        "cone",
        "impratio",
        "density",
        "viscosity",
        "wind",
    ],
    ignored: &[
        "magnetic",
        "solver",
        "iterations",
        "tolerance",
        "ls_iterations",
        "ls_tolerance",
        "jacobian",
        "noslip_tolerance",
        "ccd_iterations",
        "ccd_tolerance",
        "sdf_initpoints",
        "sdf_iterations",
        "sleep_tolerance",
        "o_friction",
        "o_margin",
        "o_solimp",
        "o_solref",
    ],
    refused: &[
        ("noslip_iterations", "0", "set it to 0; a larger `impratio` reduces slip as well"),
        ("actuatorgroupdisable", "", "remove the actuators instead"),
    ],
};

pub(crate) const FLAG: Known = Known {
    read: &["constraint", "contact", "limit", "frictionloss", "gravity", "eulerdamp", "refsafe"],
    ignored: &[
        "autoreset",
        "energy",
        "equality",
        "fwdinv",
        "invdiscrete",
        "island",
        "midphase",
        "multiccd",
        "nativeccd",
        "sensor",
        "warmstart",
    ],
    refused: &[
        ("spring", "enable", "remove the stiffness of the joints instead"),
        ("damper", "enable", "remove the damping of the joints instead"),
        ("actuation", "enable", "remove the actuators instead"),
        ("clampctrl", "enable", "remove the control ranges instead"),
        ("filterparent", "enable", "set it to enable"),
        ("override", "disable", "write the parameters to the geoms instead"),
        ("sleep", "disable", "set it to disable"),
        ("diagexact", "disable", "set it to disable"),
        ("ipc", "disable", "set it to disable"),
        ("speculative", "disable", "set it to disable"),
    ],
};

pub(crate) const BODY: Known = Known {
    read: &["name", "childclass", "pos", "quat", "axisangle", "euler", "xyaxes", "zaxis"],
    ignored: &["user", "sleep", "simple", "fuse"],
    refused: &[
        ("mocap", "false", "make it a fixed body, or move it by joints"),
        ("gravcomp", "0", "remove it, or add a motor"),
    ],
};

pub(crate) const FRAME: Known = Known {
    read: &["name", "childclass", "pos", "quat", "axisangle", "euler", "xyaxes", "zaxis"],
    ignored: &[],
    refused: &[
        ("scale", "1", "write the sizes to the elements instead"),
        ("massscale", "1", "write the masses to the elements instead"),
        ("scaling", "", "remove it"),
    ],
};

pub(crate) const INERTIAL: Known = Known {
    read: &[
        "pos",
        "quat",
        "axisangle",
        "euler",
        "xyaxes",
        "zaxis",
        "mass",
        "diaginertia",
        "fullinertia",
    ],
    ignored: &[],
    refused: &[],
};

pub(crate) const JOINT: Known = Known {
    read: &[
        "name",
        "class",
        "type",
        "pos",
        "axis",
        "ref",
        "springref",
        "stiffness",
        "damping",
        "armature",
        "frictionloss",
        "solreffriction",
        "solimpfriction",
        "limited",
        "range",
        "margin",
        "solreflimit",
        "solimplimit",
        "actuatorfrclimited",
        "actuatorfrcrange",
    ],
    ignored: &["group", "user", "actuatorgravcomp"],
    refused: &[
        ("springyield", "0", "remove it; springs are elastic"),
        ("springdamper", "0", "write `stiffness` and `damping`"),
    ],
};

pub(crate) const FREE_JOINT: Known = Known {
    read: &["name"],
    ignored: &["group"],
    refused: &[("align", "false|auto", "set it to false")],
};

pub(crate) const GEOM: Known = Known {
    read: &[
        "name",
        "class",
        "type",
        "pos",
        "quat",
        "axisangle",
        "euler",
        "xyaxes",
        "zaxis",
        "fromto",
        "size",
        "mass",
        "density",
        "contype",
        "conaffinity",
        "condim",
        "priority",
        "friction",
        "solref",
        "solimp",
        "solmix",
        "margin",
        "group",
        "material",
        "rgba",
        "mesh",
        "hfield",
    ],
    ignored: &["gap", "user", "castshadow", "fluidcoef", "fitscale"],
    refused: &[
        ("shellinertia", "false", "set it to false, and `mass` to the mass of the shell"),
        ("fluidshape", "none", "set it to none; the medium acts on the inertia of the body"),
        ("surfacevel", "0", "remove it"),
        ("adhesion", "0", "remove it"),
    ],
};

pub(crate) const SITE: Known = Known {
    read: &["name", "class", "pos", "quat", "axisangle", "euler", "xyaxes", "zaxis", "fromto"],
    ignored: &["type", "size", "group", "material", "mesh", "rgba", "user"],
    refused: &[],
};

pub(crate) const TENDON: Known = Known {
    read: &["name", "class", "limited", "range"],
    ignored: &[
        "group",
        "margin",
        "material",
        "rgba",
        "width",
        "user",
        "solimpfriction",
        "solimplimit",
        "solreffriction",
        "solreflimit",
        "springlength",
        "springyield",
        "actuatorfrclimited",
        "actuatorfrcrange",
    ],
    refused: &[
        ("stiffness", "0", "tendons that act are not supported, remove it"),
        ("damping", "0", "tendons that act are not supported, remove it"),
        ("frictionloss", "0", "tendons that act are not supported, remove it"),
        ("armature", "0", "tendons that act are not supported, remove it"),
    ],
};

pub(crate) const FIXED_JOINT: Known =
    Known { read: &["joint", "coef"], ignored: &[], refused: &[] };

/// Attributes that all actuators have; the macro adds those of one kind.
macro_rules! actuator {
    (read: [$($read:literal),*], ignored: [$($ignored:literal),*], refused: [$($refused:tt),*]) => {
        Known {
            read: &[
                "name", "class", "joint", "jointinparent", "tendon", "gear", "ctrllimited", "ctrlrange",
                "forcelimited", "forcerange", $($read),*
            ],
            ignored: &[
                "group", "user", "lengthrange", "nsample", "interp", "cranklength", $($ignored),*
            ],
            refused: &[
                ("site", "", "let the actuator act on a hinge or slide joint"),
                ("refsite", "", "let the actuator act on a hinge or slide joint"),
                ("body", "", "let the actuator act on a hinge or slide joint"),
                ("cranksite", "", "let the actuator act on a hinge or slide joint"),
                ("slidersite", "", "let the actuator act on a hinge or slide joint"),
                ("delay", "0", "remove it; controls act at once"),
                ("damping", "0", "add the damping to the joint"),
                ("armature", "0", "add the armature to the joint"),
                $($refused),*
            ],
        }
    };
}

pub(crate) const MOTOR: Known = actuator!(read: [], ignored: [], refused: []);

pub(crate) const POSITION: Known = actuator!(
    read: ["kp", "kv", "dampratio", "timeconst"],
    ignored: [],
    refused: [
        ("inheritrange", "0", "write the range as `ctrlrange`")
    ]
);

pub(crate) const VELOCITY: Known = actuator!(read: ["kv"], ignored: [], refused: []);

pub(crate) const GENERAL: Known = actuator!(
    read: ["gaintype", "gainprm", "biastype", "biasprm", "dyntype"],
    ignored: ["dynprm"],
    refused: [
        ("inheritrange", "0", "write the range as `ctrlrange`"),
        ("actdim", "-1|0", "remove it; actuators have no state"),
        ("actlimited", "false|auto", "remove it; actuators have no state"),
        ("actearly", "false", "remove it; actuators have no state"),
        ("actrange", "0", "remove it; actuators have no state"),
        ("input", "|pos|vel|pressure", "remove it"),
        ("velrange", "0", "remove it"),
        ("ffrange", "0", "remove it")
    ]
);

pub(crate) const MATERIAL: Known = Known {
    read: &["name", "class", "rgba"],
    ignored: &[
        "emission",
        "metallic",
        "reflectance",
        "roughness",
        "shininess",
        "specular",
        "texrepeat",
        "texture",
        "texuniform",
    ],
    refused: &[],
};

pub(crate) const EXCLUDE: Known =
    Known { read: &["name", "body1", "body2"], ignored: &[], refused: &[] };

pub(crate) const KEY: Known = Known {
    read: &["name", "qpos"],
    ignored: &["time", "qvel", "act", "ctrl", "mpos", "mquat", "plastic"],
    refused: &[],
};
