"""Names of a layer of `torch.nn.GRU` by ours; kernels are transposed, gates keep their order."""

GRU_NAMES = {
    "input_kernel": "weight_ih",
    "hidden_kernel": "weight_hh",
    "input_bias": "bias_ih",
    "hidden_bias": "bias_hh",
}
