//! Models of robots that come with this package.

/// Name and text of each model.
const MODELS: [(&str, &str); 9] = [
    ("ant", include_str!("../models/ant.xml")),
    ("arm", include_str!("../models/arm.urdf")),
    ("half_cheetah", include_str!("../models/half_cheetah.xml")),
    ("hopper", include_str!("../models/hopper.xml")),
    ("humanoid", include_str!("../models/humanoid.xml")),
    ("inverted_double_pendulum", include_str!("../models/inverted_double_pendulum.xml")),
    ("reacher", include_str!("../models/reacher.xml")),
    ("swimmer", include_str!("../models/swimmer.xml")),
    ("walker2d", include_str!("../models/walker2d.xml")),
];

/// Names of the models.
pub fn names() -> impl Iterator<Item = &'static str> {
    MODELS.iter().map(|(name, _)| *name)
}

/// Text of the model with this name, for [`files::parse`](crate::files::parse).
pub fn text(name: &str) -> Option<&'static str> {
    MODELS.iter().find(|(model, _)| *model == name).map(|(_, text)| *text)
}
