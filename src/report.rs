//! Pictures.
pub struct Curve { pub label: String, pub color: &'static str, pub runs: Vec<Vec<Point>> }
pub struct Point { pub epoch: f64, pub seconds: f64, pub loss: f64 }
pub struct Animation;
impl Animation { pub fn to_svg(&self) -> String { String::new() } }
pub fn learning_curve(_: &str, _: &[(f64, f64)], _: &[(f64, f64)]) -> String { String::new() }
pub fn comparison(_: &str, _: &[Curve]) -> String { String::new() }
pub fn field_color(_: &str) -> &'static str { "" }
pub fn cart_pole(_: &[Vec<f64>], _: &[f64], _: f64, _: f64) -> Animation { Animation }
