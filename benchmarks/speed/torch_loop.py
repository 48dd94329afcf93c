"""The equations of PG-RSSNN as an eager PyTorch loop over time, the way they are usually written, on our weights.

    φ = D(u_t)       x_t = f_phy(x_{t-1}, u_t) + s_x D(D([h_{t-1}, φ]))
    h_t = GRU(φ, h_{t-1})       y_t = g_phy(x_t, u_t) + s_y D(D([u_t, x_t]))

`Loop` computes everything in the loop over time. `Batched` is the best that PyTorch offers without compiling: the
networks over all samples at once, `torch.nn.GRU` for the recurrence, and a loop for the physics alone.
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import torch
from flax import nnx
from torch import nn

from pgrssnn_jax.models.model import Model, ModelParams

from .torch_names import GRU_NAMES

Step = Callable[[torch.Tensor, torch.Tensor], torch.Tensor]


class Networks(nn.Module):
    """What both forms share; each gives its own recurrence, cells or a whole GRU, under the name of its field.

    step(x, u) -> x and measure(x, u) -> y: the physics, for `[seq, x]` and `[..., x]`.
    """

    def __init__(
        self,
        model: Model,
        params: ModelParams,
        step: Step,
        measure: Step,
        dtype: torch.dtype,
        **recurrence: nn.Module,
    ) -> None:
        super().__init__()
        spec, n_h = model.spec, model.spec.hidden
        n_u, n_x, n_y = len(model.physics.inputs), model.n_x, len(model.physics.outputs)
        self.step, self.measure, self.correction = step, measure, spec.correction
        self.features_u = two_dense(n_u, n_h, n_h)
        self.mixer = two_dense(2 * n_h, n_h, n_h)
        self.head_x = two_dense(n_h, n_h, n_x)
        self.features_x = two_dense(n_u + n_x, n_h, n_h)
        self.head_y = two_dense(n_h, n_h, n_y)
        for name, affine in params.scaling._asdict().items():
            self.register_buffer(f"{name}_offset", torch.tensor(np.asarray(affine.offset)))
            self.register_buffer(f"{name}_scale", torch.tensor(np.asarray(affine.scale)))
        for name, module in recurrence.items():
            self.add_module(name, module)
        self.load_state_dict(weights(params), strict=False)
        self.to(dtype)

    def g_nn(self, scaled_u: torch.Tensor, x: torch.Tensor) -> torch.Tensor:
        scaled_x = (x - self.x_offset) / self.x_scale
        return self.y_scale * self.head_y(self.features_x(torch.cat([scaled_u, scaled_x], -1)))


class Loop(Networks):
    """Everything in the loop, one step of all networks per sample."""

    def __init__(self, model: Model, *rest: Any) -> None:
        n_h, bias = model.spec.hidden, model.spec.gru_bias
        cells = nn.ModuleList(nn.GRUCell(n_h, n_h, bias=bias) for _ in range(model.spec.gru_layers))
        super().__init__(model, *rest, cells=cells)

    def forward(self, u: torch.Tensor, x: torch.Tensor) -> torch.Tensor:
        h = [x.new_zeros(len(x), cell.hidden_size) for cell in self.cells]
        outputs = []
        for t in range(u.shape[1]):
            u_t = u[:, t]
            scaled = (u_t - self.u_offset) / self.u_scale
            phi = self.features_u(scaled)
            f_nn = self.head_x(self.mixer(torch.cat([h[-1], phi], -1)))
            x = self.step(x, u_t) + self.x_scale * self.correction * f_nn
            below = phi
            for i, cell in enumerate(self.cells):
                h[i] = below = cell(below, h[i])
            outputs.append(self.measure(x, u_t) + self.g_nn(scaled, x))
        return torch.stack(outputs, 1)


class Batched(Networks):
    """Only the physics in a Python loop."""

    def __init__(self, model: Model, *rest: Any) -> None:
        n_h, spec = model.spec.hidden, model.spec
        gru = nn.GRU(n_h, n_h, spec.gru_layers, bias=spec.gru_bias, batch_first=True)
        super().__init__(model, *rest, gru=gru)

    def forward(self, u: torch.Tensor, x: torch.Tensor) -> torch.Tensor:
        scaled = (u - self.u_offset) / self.u_scale
        phi = self.features_u(scaled)
        h = self.gru(phi)[0]
        before = torch.cat([torch.zeros_like(h[:, :1]), h[:, :-1]], 1)
        corrections = self.x_scale * self.correction * self.head_x(self.mixer(torch.cat([before, phi], -1)))
        states = []
        for u_t, correction in zip(u.unbind(1), corrections.unbind(1), strict=True):
            x = self.step(x, u_t) + correction
            states.append(x)
        whole = torch.stack(states, 1)
        return self.measure(whole, u) + self.g_nn(scaled, whole)


def two_dense(n_in: int, hidden: int, n_out: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(n_in, hidden), nn.ReLU(), nn.Linear(hidden, n_out))


def weights(params: ModelParams) -> dict[str, torch.Tensor]:
    """Our weights under the names of both forms of the recurrence; PyTorch keeps kernels transposed."""
    tree = nnx.to_pure_dict(params.network)
    found: dict[str, Any] = {}
    for name in ("features_u", "mixer", "head_x", "features_x", "head_y"):
        for place, layer in (("0", "first"), ("2", "second")):
            found[f"{name}.{place}.weight"] = np.asarray(tree[name][layer]["kernel"]).T
            found[f"{name}.{place}.bias"] = np.asarray(tree[name][layer]["bias"])
    for i, layer in tree["gru"].items():
        for name, array in gru_weights(layer).items():
            found[f"gru.{name}_l{i}"] = found[f"cells.{i}.{name}"] = array
    return {name: torch.tensor(np.ascontiguousarray(array)) for name, array in found.items()}


def gru_weights(layer: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """Those of one layer by PyTorch's names."""
    return {GRU_NAMES[name]: np.asarray(array).T for name, array in layer.items() if array is not None}


def epoch(networks: Networks, u: torch.Tensor, y: torch.Tensor, x0: torch.Tensor) -> Callable[[], torch.Tensor]:
    """One training epoch as ours: mean over sequences of the squared scaled errors, clipped gradient, AdamW."""
    optimizer = torch.optim.AdamW(networks.parameters(), lr=1e-3, weight_decay=1e-2)

    def run() -> torch.Tensor:
        optimizer.zero_grad()
        value = loss(networks, u, y, x0)
        value.backward()
        nn.utils.clip_grad_norm_(networks.parameters(), 1.0)
        optimizer.step()
        return value.detach()

    return run


def loss(networks: Networks, u: torch.Tensor, y: torch.Tensor, x0: torch.Tensor) -> torch.Tensor:
    return (((networks(u, x0) - y) / networks.y_scale) ** 2).sum() / len(u)


def free_run(networks: Networks, u: torch.Tensor, x0: torch.Tensor) -> Callable[[], torch.Tensor]:
    def run() -> torch.Tensor:
        with torch.no_grad():
            return networks(u, x0)

    return run


def tensor(array: Any, dtype: torch.dtype) -> torch.Tensor:
    return torch.tensor(np.asarray(array), dtype=dtype)
