"""GPyTorch's exact LCM as its own examples build it, with gaps."""

from __future__ import annotations

import gpytorch
import numpy as np
import torch


class GappedLCM(gpytorch.models.ExactGP):
    """The LCM of values (m,) of some outputs each: as many RBF kernels, each with outputs mixed by rank 1."""

    def __init__(self, inputs, values, likelihood, n_outputs, n_latent):
        super().__init__(inputs, values, likelihood)
        self.mean_module = gpytorch.means.ConstantMean()
        d = inputs[0].shape[1]
        self.kernels = torch.nn.ModuleList()
        self.mixings = torch.nn.ModuleList()
        for _ in range(n_latent):
            self.kernels.append(gpytorch.kernels.RBFKernel(ard_num_dims=d))
            self.mixings.append(gpytorch.kernels.IndexKernel(num_tasks=n_outputs, rank=1))

    def forward(self, x, output):
        parts = [k(x).mul(B(output)) for k, B in zip(self.kernels, self.mixings, strict=True)]
        total = sum(parts[1:], start=parts[0])
        return gpytorch.distributions.MultivariateNormal(self.mean_module(x), total)


def gapped_lcm(X, Y, n_latent):
    """Return means and standard deviations (n, P) from Y with gaps, by Adam as in GPyTorch's Hadamard example."""
    torch.manual_seed(0)
    rows, outputs = (torch.as_tensor(part) for part in np.nonzero(np.isfinite(Y)))
    x, values = (torch.as_tensor(part, dtype=torch.float64) for part in (X, Y))
    inputs = x[rows], outputs[:, None]
    likelihood = gpytorch.likelihoods.GaussianLikelihood().double()
    model = GappedLCM(inputs, values[rows, outputs], likelihood, Y.shape[1], n_latent).double()
    objective = gpytorch.mlls.ExactMarginalLogLikelihood(likelihood, model)
    optimizer = torch.optim.Adam(model.parameters(), lr=0.1)
    factorised = gpytorch.settings.fast_computations(
        covar_root_decomposition=False, log_prob=False, solves=False
    )
    with factorised, gpytorch.settings.cholesky_max_tries(6):
        for _ in range(100):
            optimizer.zero_grad()
            loss = -objective(model(*inputs), values[rows, outputs])
            loss.backward()
            optimizer.step()
        model.eval()
        means = []
        deviations = []
        with torch.no_grad():
            for p in range(Y.shape[1]):
                found = likelihood(model(x, torch.full((len(X), 1), p)))
                means.append(found.mean.numpy())
                deviations.append(found.stddev.numpy())
    return np.column_stack(means), np.column_stack(deviations)
