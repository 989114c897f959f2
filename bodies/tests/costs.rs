//! Operations of steps and of their reverse derivatives: constraints that are absent cost nothing.

use physgrad::count::{OpCount, TaskOpCount};
use physgrad::{Number, System as _};
use physgrad_bodies::model::{Integrator, Model, Transmission};
use physgrad_bodies::{Bodies, BodiesTask, files};

/// A leg above a floor. At the state of the counts its joints are at their limits, and it touches
/// the floor and itself.
fn leg(options: &str, joint: &str, geom: &str, contact: &str) -> Model {
    let inertial = "<inertial pos='0 0 -.1' mass='1' diaginertia='.01 .01 .01'/>";
    let plane = match geom {
        "" => String::new(),
        geom => format!("<geom type='plane' size='1 1 1' {geom}/>"),
    };
    let capsule = |x: &str| match geom {
        "" => String::new(),
        geom => format!("<geom type='capsule' size='.3' fromto='{x} 0 0 {x} 0 -.2' {geom}/>"),
    };
    let [upper, middle, lower] = ["0", ".1", ".2"].map(capsule);
    let text = format!(
        "<mujoco><option>{options}</option><worldbody>{plane}
           <body name='a'><joint name='z' type='slide' axis='0 0 1' {joint}/>{inertial}{upper}
             <body name='b'><joint name='hip' axis='0 1 0' {joint}/>{inertial}{middle}
               <body name='c'><joint name='knee' axis='0 1 0' {joint}/>{inertial}{lower}</body>
             </body></body></worldbody>
         <contact>{contact}</contact>
         <actuator><motor name='m' joint='hip'/></actuator></mujoco>"
    );
    files::parse(&text, "leg.xml").unwrap()
}

/// The operations of a step of the model. Compiled by the package.
fn cost(model: &Model) -> OpCount {
    let bodies = Bodies::new(model.clone()).unwrap();
    let start = vec![Number::Fixed(0.0); bodies.state_dim()];
    TaskOpCount::of(&BodiesTask::new(bodies, 1, start, 1).erased()).system
}

/// Without a coefficient of its own, a tendon costs as much as its joint.
#[test]
fn a_tendon_of_one_joint_costs_as_much_as_the_joint() {
    let (joint, pull) = (leg("", "", "", ""), leg("", "", "", ""));
    let with = |ends: Vec<(usize, f64)>| {
        let mut model = pull.clone();
        model.actuators[0].on = Transmission::Tendon(ends);
        cost(&model)
    };
    let alone = cost(&joint);
    assert_eq!(with(vec![(0, 0.0), (1, 1.0)]), alone);
    assert!(with(vec![(0, 0.5), (1, 1.0)]).step.total() > alone.step.total());
}

const LIMITS: &str = "range='-.05 .05' ";
const FRICTION: &str = "frictionloss='.3' ";
const ALL: &str = "range='-.05 .05' frictionloss='.3'";
const TOUCHING: &str = "contype='1'";

#[test]
fn absent_constraints_cost_no_operations() {
    for integrator in [Integrator::Euler, Integrator::ImplicitFast, Integrator::Rk4] {
        let count = |mut model: Model| {
            model.options.integrator = integrator;
            cost(&model)
        };
        let bare = count(leg("", "", "", ""));
        let mut switched = leg("", ALL, TOUCHING, "");
        (switched.options.contacts, switched.options.limits) = (false, false);
        switched.joints.iter_mut().for_each(|joint| joint.friction_loss = 0.0);
        let exclusions = ["world' body2='a", "world' body2='b", "world' body2='c", "a' body2='c"]
            .map(|pair| format!("<exclude body1='{pair}'/>"));
        let each = "<flag contact='disable' limit='disable' frictionloss='disable'/>";
        let unlimited = "limited='false' range='-.05 .05' frictionloss='0'";
        let untouching = "contype='0' conaffinity='0'";
        for (what, model) in [
            ("flag of constraints", leg("<flag constraint='disable'/>", ALL, TOUCHING, "")),
            ("flags of each kind", leg(each, ALL, TOUCHING, "")),
            ("attributes", leg("", unlimited, untouching, "")),
            ("exclusions", leg("", "", TOUCHING, &exclusions.concat())),
            ("options", switched),
        ] {
            assert_eq!(count(model), bare, "{what}, {integrator:?}");
        }
        // Each kind alone costs as much as without the flags of the others, and more than none.
        let without = |kinds: &str| format!("<flag {kinds}/>");
        let [contact, limit, friction] =
            ["contact='disable' ", "limit='disable' ", "frictionloss='disable' "];
        for (what, alone, flagged) in [
            (
                "contacts",
                leg("", "", TOUCHING, ""),
                leg(&without(&[limit, friction].concat()), ALL, TOUCHING, ""),
            ),
            (
                "limits",
                leg("", LIMITS, "", ""),
                leg(&without(&[contact, friction].concat()), ALL, TOUCHING, ""),
            ),
            (
                "friction",
                leg("", FRICTION, "", ""),
                leg(&without(&[contact, limit].concat()), ALL, TOUCHING, ""),
            ),
        ] {
            let alone = count(alone);
            assert_eq!(count(flagged), alone, "{what}, {integrator:?}");
            assert!(alone.step.total() > bare.step.total(), "{what}, {integrator:?}");
            assert!(alone.vjp.total() > bare.vjp.total(), "{what}, {integrator:?}");
        }
    }
}
