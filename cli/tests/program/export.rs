//! Policies in files for other programs.

use super::numbers::physgrad;
use super::python;
use serde_json::{Value, json};
use std::fs;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

const SMALL: &str =
    "--set training.train_samples=16 --set training.test_samples=8 --set horizon=25";

/// Trains for one epoch in the folder `name`, and exports the policy.
fn trained(dir: &TempDir, name: &str, scene: &str) -> PathBuf {
    physgrad(&format!("train {scene} {SMALL} --epochs 1 --quiet --out {name}"), dir.path())
        .assert()
        .success();
    physgrad(&format!("export {name} --onnx {name}/policy.onnx --quiet"), dir.path())
        .assert()
        .success();
    dir.path().join(name)
}

/// Returns the description of a policy from the header of its file. The file starts with the length
/// of the header as a little-endian u64, followed by the header in JSON.
fn about(file: &Path) -> Value {
    let bytes = fs::read(file).expect("a policy");
    let (length, rest) = bytes.split_first_chunk().expect("a length");
    let header: Value =
        serde_json::from_slice(&rest[..u64::from_le_bytes(*length) as usize]).expect("JSON");
    serde_json::from_str(header["__metadata__"]["physgrad"].as_str().expect("text")).expect("JSON")
}

#[test]
fn other_programs_compute_the_controls_of_a_rollout() {
    let dir = TempDir::new().expect("a folder");
    let mlp = "--set policy.zero_init_output=false --set policy.widths=[24,16]";
    let runs = [
        ("tanh", format!("cart_pole {mlp}")),
        ("relu", format!("cart_pole {mlp} --set policy.activation=relu")),
        ("silu", format!("cart_pole {mlp} --set policy.activation=silu --precision f64")),
        ("gelu", format!("cart_pole {mlp} --set policy.activation=gelu --precision f64")),
        ("without_bias", format!("guidance {mlp} --set policy.bias=false")),
        ("linear", "cart_pole --set policy.zero_init_output=false --set policy.widths=[]".into()),
        ("bounded", format!("cart_pole {mlp} --set policy.bounds=[[-2.0,3.0]]")),
        ("bounded_conv", "quantum --set policy.width=9 --set policy.bounds=[[-0.5,0.5]]".into()),
        ("with_actuator", format!("cart_pole_1 {mlp} --set actuator.delay.steps=2")),
        ("quantum", "quantum --set policy.width=20".into()),
        ("quantum_f64", "quantum --set policy.width=9 --set system.grid=17 --precision f64".into()),
    ];
    let folders: Vec<PathBuf> =
        runs.iter().map(|(name, scene)| trained(&dir, name, scene)).collect();
    let folders: Vec<&Path> = folders.iter().map(PathBuf::as_path).collect();
    if let Some(text) = python::run("check_policies.py", &folders) {
        assert_eq!(text.lines().count(), 3 * runs.len(), "three readings of every policy\n{text}");
    }
}

#[test]
fn a_policy_file_describes_its_network() {
    let dir = TempDir::new().expect("a folder");
    let layer = |kind: Value, i: usize, activation: Value| {
        let mut layer = json!({ "kernel": format!("layer{i}.kernel"), "bias": format!("layer{i}.bias"), "activation": activation });
        layer
            .as_object_mut()
            .expect("an object")
            .extend(kind.as_object().expect("an object").clone());
        layer
    };
    let (dense, conv) = (json!({ "kind": "dense" }), json!({ "kind": "conv", "stride": 2 }));
    let scene = "cart_pole_1 --set policy.widths=[5] --set policy.activation=gelu --set actuator.lag.time=0.1";
    let run = trained(&dir, "mlp", scene);
    let expected = json!({
        "physgrad": env!("CARGO_PKG_VERSION"),
        "task": "cart_pole",
        "observations": ["x", "x_dot", "theta_1", "omega_1", "force_before"],
        "controls": ["force"],
        "layers": [layer(dense.clone(), 1, json!("gelu")), layer(dense.clone(), 2, Value::Null)],
        "policy": { "kind": "mlp", "widths": [5], "activation": "gelu", "bias": true },
    });
    assert_eq!(about(&run.join("policy.safetensors")), expected);
    let run = trained(&dir, "conv", "quantum --set policy.width=3");
    let layers = json!([
        layer(conv.clone(), 1, json!("tanh")),
        layer(conv, 2, json!("tanh")),
        layer(dense, 3, Value::Null)
    ]);
    assert_eq!(about(&run.join("best_policy.safetensors"))["layers"], layers);
}

#[test]
fn an_export_names_its_inputs_and_outputs_and_selects_the_epoch() {
    let dir = TempDir::new().expect("a folder");
    let train = format!(
        "train cart_pole_1 {SMALL} --set policy.widths=[6] --set training.learning_rate=0.3 --quiet"
    );
    physgrad(&format!("{train} --epochs 4 --out run"), dir.path()).assert().success();
    let output = physgrad("export run --onnx last.onnx", dir.path()).assert().success();
    let text = String::from_utf8(output.get_output().stdout.clone()).expect("text");
    assert!(text.contains("input observation [batch, 4]: x, x_dot, theta_1, omega_1\n"), "{text}");
    assert!(text.contains("output control [batch, 1]: force\n"), "{text}");
    physgrad("export run --onnx best.onnx --epoch best", dir.path()).assert().success();
    // A model contains the bytes of every tensor of the policy file.
    for (model, policy) in [("last", "policy"), ("best", "best_policy")] {
        let model = fs::read(dir.path().join(format!("{model}.onnx"))).expect("a model");
        let file =
            fs::read(dir.path().join(format!("run/{policy}.safetensors"))).expect("a policy");
        let tensors = safetensors::SafeTensors::deserialize(&file).expect("safetensors");
        for (name, tensor) in tensors.tensors() {
            assert!(
                model.windows(tensor.data().len()).any(|bytes| bytes == tensor.data()),
                "{name} of {policy}"
            );
        }
    }
    for (args, message) in [
        ("export absent --onnx a.onnx", "there is no folder absent"),
        ("export run --onnx absent/a.onnx", "there is no folder absent"),
        ("export run --onnx run", "--onnx: run: it exists and is not a regular file"),
    ] {
        let output = physgrad(args, dir.path()).assert().failure();
        let error = String::from_utf8_lossy(&output.get_output().stderr).into_owned();
        assert!(error.contains(message), "{error}");
    }
    #[cfg(unix)]
    {
        let link = dir.path().join("link.onnx");
        std::os::unix::fs::symlink("last.onnx", &link).expect("a link");
        physgrad("export run --onnx link.onnx", dir.path()).assert().failure();
        assert!(link.is_symlink(), "the export replaces a link");
    }
}
