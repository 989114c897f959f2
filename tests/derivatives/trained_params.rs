//! Trained parameters: nested lists, and refused entries.

use super::inputs::{gradients, tracking};
use physgrad::policy::{Bounded, Constant, Linear, TrainedParam, WithParams};
use physgrad::rng::{Purpose, stream};
use physgrad::{Policy, Weights, check};

#[test]
fn nested_trained_parameters_are_those_of_one_list() {
    let trained = [TrainedParam::log(0, 0.8), TrainedParam::bounded(1, 0.2, -1.0, 0.5)];
    let inner = WithParams::new(Linear::with_bias(3, 1), [trained[0]]);
    // Wrappers between both lists forward the inner entries.
    let nested = WithParams::new(Bounded::new(inner.clone(), [2.0]), [trained[1]]);
    assert_eq!(Policy::trained_params(&nested), trained);
    check::policy(&nested).unwrap();
    check::task(&tracking::<1>(), &nested).unwrap();

    let (nested, flat) =
        (WithParams::new(inner, [trained[1]]), WithParams::new(Linear::with_bias(3, 1), trained));
    assert_eq!((nested.param_count(), nested.tensors()), (flat.param_count(), flat.tensors()));
    assert_eq!(gradients(&tracking::<1>(), &nested, 1), gradients(&tracking::<1>(), &flat, 1));
    let weights = Weights::<f64>::init(&nested, &mut stream(0, Purpose::Policy, 0));
    assert!(
        nested
            .values(weights.theta())
            .iter()
            .zip([0.8, 0.2])
            .all(|(value, initial)| (value - initial).abs() < 1e-15)
    );
}

#[test]
#[should_panic(expected = "p[1] is trained twice; pass one `TrainedParam`")]
fn training_an_entry_twice_is_refused() {
    let inner = WithParams::new(Constant::new(3, 1), [TrainedParam::log(1, 0.8)]);
    WithParams::new(inner, [TrainedParam::linear(0, 0.8), TrainedParam::linear(1, 0.8)]);
}

#[test]
#[should_panic(
    expected = "p[3] is trained above 0 from an initial value of -0.5; pass a finite initial value above the bound"
)]
fn a_negative_initial_value_on_a_logarithmic_scale_is_refused() {
    TrainedParam::log(3, -0.5);
}

#[test]
#[should_panic(
    expected = "p[3] is trained between 0 and inf from an initial value of 1; pass finite bounds"
)]
fn an_infinite_bound_is_refused() {
    TrainedParam::bounded(3, 1.0, 0.0, f64::INFINITY);
}
