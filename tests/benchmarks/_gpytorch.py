"""GPyTorch's LCM as its own examples build it: exact with gaps, and sparse and variational."""

from __future__ import annotations

import gpytorch
import numpy as np
import torch
from gpytorch.variational import (
    CholeskyVariationalDistribution,
    LMCVariationalStrategy,
    VariationalStrategy,
)
from numpy.random import default_rng


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
    with cholesky(), gpytorch.settings.cholesky_max_tries(6):
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


def cholesky():
    """Return the settings in which everything is done by Cholesky factorisation."""
    return gpytorch.settings.fast_computations(
        covar_root_decomposition=False, log_prob=False, solves=False
    )


class Variational(gpytorch.models.ApproximateGP):
    """Latent processes with inducing points of their own, mixed linearly."""

    def __init__(self, Z, n_outputs):
        L, m, d = Z.shape
        batch = torch.Size([L])
        strategy = VariationalStrategy(
            self,
            Z,
            CholeskyVariationalDistribution(m, batch_shape=batch),
            learn_inducing_locations=True,
        )
        super().__init__(
            LMCVariationalStrategy(strategy, num_tasks=n_outputs, num_latents=L, latent_dim=-1)
        )
        self.mean_module = gpytorch.means.ConstantMean(batch_shape=batch)
        rbf = gpytorch.kernels.RBFKernel(ard_num_dims=d, batch_shape=batch)
        self.covar_module = gpytorch.kernels.ScaleKernel(rbf, batch_shape=batch)

    def forward(self, x):
        return gpytorch.distributions.MultivariateNormal(self.mean_module(x), self.covar_module(x))


class SparseLCM:
    """Sparse variational LCM: six latents, 150 inducing points each, 2000 steps of Adam on batches of 512."""

    def fit(self, X, Y):
        torch.set_num_threads(1)  # small matrices: faster so
        torch.manual_seed(0)
        rng = default_rng(0)
        size = min(150, len(X))
        starts = np.stack([X[rng.choice(len(X), size, replace=False)] for _ in range(6)])
        X, Y = (torch.as_tensor(part, dtype=torch.float32) for part in (X, Y))
        self.model = Variational(torch.as_tensor(starts, dtype=torch.float32), Y.shape[1])
        self.likelihood = gpytorch.likelihoods.MultitaskGaussianLikelihood(num_tasks=Y.shape[1])
        objective = gpytorch.mlls.VariationalELBO(self.likelihood, self.model, num_data=len(Y))
        parameters = [*self.model.parameters(), *self.likelihood.parameters()]
        optimizer = torch.optim.Adam(parameters, lr=0.02)
        batches = iter(())
        for _ in range(2000):
            rows = next(batches, None)
            if rows is None:  # each row has had its turn
                batches = iter(torch.randperm(len(X)).split(512))
                rows = next(batches)
            optimizer.zero_grad()
            (-objective(self.model(X[rows]), Y[rows])).backward()
            optimizer.step()
        self.model.eval()
        return self

    def predict(self, X):
        return self._of_parts(X, lambda posterior: posterior.mean)

    def bands(self, X):
        variance = self._of_parts(X, lambda posterior: posterior.variance)
        noise = (self.likelihood.task_noises + self.likelihood.noise).detach().double().numpy()
        return np.sqrt(variance), np.sqrt(variance + noise)

    def _of_parts(self, X, moment):
        with torch.no_grad():
            parts = torch.as_tensor(X, dtype=torch.float32).split(2048)
            return torch.cat([moment(self.model(part)) for part in parts]).double().numpy()
