//! Mutations of valid files: every text gives a model that is sound or an error, never a panic.

use crate::files::FileError;
use crate::model::{Form, Model, Softness};
use crate::{mjcf, urdf};

const MJCF: &str = "<mujoco model='m'>
<compiler angle='radian' eulerseq='xyz' inertiagrouprange='0 3' boundmass='.01' settotalmass='9'/>
<option timestep='.01' gravity='0 0 -9' integrator='RK4' cone='elliptic' density='1' wind='1 0 0'>
<flag contact='enable' limit='disable' refsafe='enable'/></option>
<asset><material name='red' rgba='1 0 0 1'/><mesh name='m' file='m.stl'/></asset>
<default><joint damping='1' armature='.1'/><geom friction='1 .1 .1' density='500' solref='.02 1'/>
<motor ctrlrange='-1 1'/><default class='leg'><geom type='capsule' size='.1'/>
<joint range='-1 1' solimplimit='.9 .95 .001' margin='.01'/></default></default>
<?from 7 part.xml?><worldbody><geom name='floor' type='plane' size='1 1 1' material='red' condim='4'/>
<light/><camera/><body name='a' pos='0 0 1' euler='.1 .2 .3'><freejoint name='root'/>
<geom type='ellipsoid' size='.1 .2 .3' mass='2'/><site name='s' pos='0 0 1'/>
<frame pos='0 0 .1' axisangle='0 0 1 2'><body name='b' childclass='leg' quat='1 0 1 0'>
<joint name='j' axis='0 1 0' ref='.1' springref='.2' stiffness='3' frictionloss='.1'/>
<joint name='k' type='slide' actuatorfrcrange='-1 1'/><geom fromto='0 0 0 0 0 1'/>
<geom type='mesh' mesh='m' contype='0' conaffinity='0' mass='0'/>
<body name='c' xyaxes='1 0 0 0 1 0'><joint type='ball' limited='false'/>
<inertial pos='0 0 1' mass='1' fullinertia='1 1 1 .1 .1 .1'/></body></body></frame></body>
<body name='d' zaxis='0 1 1'><geom class='leg' type='box' size='.1 .1 .1' gap='.1'/></body>
</worldbody>
<contact><exclude body1='a' body2='d'/></contact>
<tendon><fixed name='t'><joint joint='j' coef='1'/></fixed><fixed name='s'>
<joint joint='j' coef='.5'/><joint joint='k' coef='-2'/></fixed></tendon>
<actuator><motor joint='j' gear='2' ctrllimited='true'/><position joint='k' kp='3' kv='1'/>
<velocity joint='j' kv='2'/><general joint='k' biastype='affine' gainprm='1' biasprm='1 2 3'/>
<motor tendon='s' gear='3'/></actuator>
<sensor><jointpos joint='j'/></sensor>
<keyframe><key name='up' qpos='0 0 1 1 0 0 0 0 0 1 0 0 0'/><key/></keyframe></mujoco>";

const URDF: &str = "<robot name='r'>
<link name='base'><inertial><mass value='1'/><inertia ixx='1' iyy='1' izz='1'/></inertial>
<collision><geometry><box size='1 2 3'/></geometry></collision></link>
<link name='arm'><inertial><origin xyz='0 0 1' rpy='0 1 0'/><mass value='2'/>
<inertia ixx='1' ixy='.1' ixz='0' iyy='2' iyz='0' izz='2'/></inertial><visual/>
<collision><origin xyz='1 0 0'/><geometry><cylinder radius='1' length='2'/></geometry></collision>
<collision><geometry><mesh filename='a.stl'/></geometry></collision></link>
<link name='hand'><collision><geometry><sphere radius='.1'/></geometry></collision></link>
<joint name='j' type='revolute'><parent link='base'/><child link='arm'/><axis xyz='0 1 0'/>
<origin xyz='1 2 3' rpy='.1 .2 .3'/><limit lower='-1' upper='1' effort='9' velocity='1'/>
<dynamics damping='1' friction='.1'/></joint>
<joint name='k' type='fixed'><parent link='arm'/><child link='hand'/></joint></robot>";

/// SplitMix64.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    fn below(&mut self, count: usize) -> usize {
        (self.next() % count.max(1) as u64) as usize
    }
}

/// Where the text in quotes of an attribute begins and ends.
fn value(text: &str, random: &mut Random) -> Option<(usize, usize)> {
    let starts: Vec<usize> = text.match_indices("='").map(|(i, _)| i + 2).collect();
    let start = *starts.get(random.below(starts.len()))?;
    Some((start, start + text[start..].find('\'')?))
}

/// One change: of a byte, of an attribute, of a value, or of elements.
fn mutate(text: &str, random: &mut Random) -> Option<String> {
    const VALUES: [&str; 20] = [
        "",
        "nan",
        "inf",
        "-1",
        "0",
        "1e308",
        "-1e-308",
        "1e20",
        "1 2 3 4 5 6 7",
        "true",
        "false",
        "auto",
        "0 0 0",
        "1",
        "leg",
        "1e-20",
        "j",
        "a",
        "&#0;",
        "0 0 0 0",
    ];
    let (start, end) = value(text, random)?;
    let (a, b) = value(text, random)?;
    let name = |at: usize| text[..at - 2].rfind(' ').map(|n| (n + 1, at - 2));
    let (from, to, new) = match random.below(8) {
        0 => return Some(byte(text, random)),
        1 => (name(start)?.0, end + 1, String::new()),
        2 => (start, end, text[a..b].to_string()),
        3 => {
            let ((c, d), (e, f)) = (name(start)?, name(a)?);
            (c, d, text[e..f].to_string())
        }
        4 => elements(text, random),
        _ => (start, end, VALUES[random.below(VALUES.len())].to_string()),
    };
    let mut text = text.to_string();
    text.replace_range(from..to, &new);
    Some(text)
}

fn byte(text: &str, random: &mut Random) -> String {
    let mut bytes = text.as_bytes().to_vec();
    let at = random.below(bytes.len());
    bytes[at] = random.next() as u8;
    String::from_utf8_lossy(&bytes).into_owned()
}

/// Some tags in a row, to be removed or doubled.
fn elements(text: &str, random: &mut Random) -> (usize, usize, String) {
    let tags: Vec<usize> = text.match_indices('<').map(|(i, _)| i).collect();
    let (first, count) = (random.below(tags.len()), 1 + random.below(6));
    let (from, to) = (tags[first], *tags.get(first + count).unwrap_or(&text.len()));
    let times = 2 * random.below(2);
    (from, to, text[from..to].repeat(times))
}

/// All numbers of a model.
fn numbers(model: &Model) -> Vec<f64> {
    let soft = |s: &Softness| [s.reference.as_slice(), s.impedance.as_slice()].concat();
    let o = &model.options;
    let mut all = vec![o.dt, o.impedance_ratio, o.density, o.viscosity];
    all.extend(o.gravity.iter().chain(&o.wind));
    for b in &model.bodies {
        all.push(b.mass);
        all.extend(b.position.iter().chain(&b.centre).chain(&b.inertia));
        all.extend(b.rotation.as_flattened());
    }
    for j in &model.joints {
        all.extend([j.reference, j.spring_reference, j.stiffness, j.damping, j.armature]);
        all.push(j.friction_loss);
        all.extend(j.point.iter().chain(&j.axis).chain(&soft(&j.friction_softness)));
        all.extend(j.force_range.iter().flatten());
        if let Some(limit) = j.limit {
            all.push(limit.margin);
            all.extend(limit.range.iter().chain(&soft(&limit.softness)));
        }
    }
    for s in &model.shapes {
        all.extend([s.mix, s.margin]);
        all.extend(s.position.iter().chain(&s.friction).chain(&soft(&s.softness)));
        all.extend(s.rotation.as_flattened().iter().chain(&s.colour));
    }
    all.extend(model.sites.iter().flat_map(|s| s.position));
    for a in &model.actuators {
        all.extend([a.gear, a.gain]);
        all.extend(a.on.joints().iter().map(|end| end.1));
        all.extend(a.bias.iter().chain(a.control_range.iter().flatten()));
        all.extend(a.force_range.iter().flatten());
    }
    all.extend(model.poses.iter().flat_map(|(_, q)| q));
    all
}

/// What every model that is read must be.
fn sound(model: &Model) -> Result<(), String> {
    let check = |good: bool, what: &str| if good { Ok(()) } else { Err(what.to_string()) };
    check(numbers(model).iter().all(|x| x.is_finite()), "a number is not finite")?;
    check(model.options.dt > 0.0, "the time step is not positive")?;
    let parents = model.bodies.iter().enumerate().skip(1).all(|(i, b)| b.parent < i);
    check(parents && !model.bodies.is_empty(), "a parent does not precede its child")?;
    let rotation = |m: &[[f64; 3]; 3]| {
        let square = crate::rotation::product(m, &crate::rotation::transposed(m));
        let identity = crate::rotation::IDENTITY;
        let pairs = square.as_flattened().iter().zip(identity.as_flattened());
        pairs.into_iter().all(|(a, b)| (a - b).abs() < 1e-9)
    };
    check(model.bodies.iter().all(|b| b.mass >= 0.0 && rotation(&b.rotation)), "a bad body")?;
    let bodies = model.bodies.len();
    check(model.joints.iter().all(|j| (1..bodies).contains(&j.body)), "a joint without body")?;
    check(model.joints.is_sorted_by_key(|j| j.body), "joints are not in the order of bodies")?;
    let unit = |a: &[f64; 3]| (a.iter().map(|x| x * x).sum::<f64>() - 1.0).abs() < 1e-9;
    check(model.joints.iter().all(|j| unit(&j.axis) && j.damping >= 0.0), "a bad joint")?;
    let ordered = |r: &[f64; 2]| r[0] < r[1];
    check(model.joints.iter().filter_map(|j| j.limit).all(|l| ordered(&l.range)), "a bad limit")?;
    check(model.shapes.iter().all(|s| s.body < bodies && rotation(&s.rotation)), "a bad shape")?;
    check(model.shapes.is_sorted_by_key(|s| s.body), "shapes are not in the order of bodies")?;
    let positive = |form: &Form| match form {
        Form::Plane => true,
        Form::Sphere(r) => *r > 0.0,
        Form::Capsule(r, h) | Form::Cylinder(r, h) => *r > 0.0 && *h > 0.0,
        Form::Ellipsoid(s) | Form::Box(s) => s.iter().all(|x| *x > 0.0),
    };
    check(model.shapes.iter().all(|s| positive(&s.form)), "a size is not positive")?;
    let joints = model.joints.len();
    let ends: Vec<_> = model.actuators.iter().flat_map(|a| a.on.joints()).collect();
    check(ends.iter().all(|end| end.0 < joints), "an actuator without joint")?;
    check(model.excluded.iter().flatten().all(|b| *b < bodies), "an excluded body is missing")?;
    let ranges = model.actuators.iter().flat_map(|a| [a.control_range, a.force_range]);
    check(ranges.flatten().all(|r| ordered(&r)), "a bad range")
}

type Parse = fn(&str, &str) -> Result<Model, FileError>;

#[test]
fn mutated_files_give_sound_models_or_errors() {
    let count = if cfg!(debug_assertions) { 4_000 } else { 100_000 };
    for (original, parse) in [(MJCF, mjcf::parse as Parse), (URDF, urdf::parse as Parse)] {
        sound(&parse(original, "m.xml").unwrap_or_else(|e| panic!("{e}"))).unwrap();
        let mut random = Random(7);
        let (mut read, mut refused) = (0, 0);
        for _ in 0..count / 2 {
            let mut text = original.to_string();
            for _ in 0..1 + random.below(3) {
                text = mutate(&text, &mut random).unwrap_or(text);
            }
            match parse(&text, "m.xml") {
                Ok(model) => {
                    sound(&model).unwrap_or_else(|what| panic!("{what}:\n{text}"));
                    read += 1;
                }
                Err(error) => {
                    assert!(!error.what.is_empty() && error.to_string().len() < 1000, "{error}");
                    refused += 1;
                }
            }
        }
        // Neither side of the readers stays untested.
        assert!(read > count / 50 && refused > count / 50, "{read} read, {refused} refused");
    }
}
