import json
import numpy as np
import safetensors

FUNCTIONS = {"tanh": np.tanh, "relu": lambda z: np.maximum(z, 0), "silu": lambda z: z / (1 + np.exp(-z)), None: lambda z: z}
FUNCTIONS["gelu"] = lambda z: z / 2 * (1 + np.tanh((2 / np.pi) ** 0.5 * (z + 0.044715 * z**3)))


def controls(file, x):
    """Controls of a policy file for observations x, one row per sample."""
    with safetensors.safe_open(file, "numpy") as f:
        for layer in json.loads(f.metadata()["physgrad"])["layers"]:
            w = f.get_tensor(layer["kernel"])
            b = f.get_tensor(layer["bias"]) if layer["bias"] else 0
            if layer["kind"] == "conv":
                x = x.reshape(len(x), -1, w.size // w.shape[0] // w.shape[-1])
                starts = range(0, x.shape[1] - w.shape[0] + 1, layer["stride"])
                x = np.stack([x[:, q : q + w.shape[0]].reshape(len(x), -1) for q in starts], axis=1)
            z = x @ w.reshape(-1, w.shape[-1]) + b
            x = FUNCTIONS[layer["activation"]](z).reshape(len(z), -1)
            for z, bound in zip(x.T, layer.get("bounds", [])):
                width = bound["half_width"]
                z[:] = bound["middle"] + width * np.tanh((z - bound["origin"]) / width)
    return x
