"""GPyTorch's models as its own examples build them: the exact LCM, and sparse variational ones of several outputs."""

from __future__ import annotations

import gpytorch
import numpy as np
import torch
from gpytorch.variational import (
    CholeskyVariationalDistribution,
    LMCVariationalStrategy,
    VariationalStrategy,
)


class LCM(gpytorch.models.ExactGP):
    """The linear model of coregionalisation: as many RBF kernels, each with its own coregionalisation of rank 1."""

    def __init__(self, X, Y, likelihood, n_latent):
        super().__init__(X, Y, likelihood)
        d, P = X.shape[1], Y.shape[1]
        self.mean_module = gpytorch.means.MultitaskMean(gpytorch.means.ConstantMean(), num_tasks=P)
        kernels = [gpytorch.kernels.RBFKernel(ard_num_dims=d) for _ in range(n_latent)]
        self.covar_module = gpytorch.kernels.LCMKernel(kernels, num_tasks=P, rank=1)

    def forward(self, x):
        return gpytorch.distributions.MultitaskMultivariateNormal(
            self.mean_module(x), self.covar_module(x)
        )


def exact_lcm(X, Y, n_latent, *, length_scale=1.0, noise=0.1, dtype=torch.float64):
    """Return model and likelihood at stated hyperparameters, the mixing drawn at random but always alike."""
    torch.manual_seed(0)
    X, Y = torch.as_tensor(X, dtype=dtype), torch.as_tensor(Y, dtype=dtype)
    likelihood = gpytorch.likelihoods.MultitaskGaussianLikelihood(
        num_tasks=Y.shape[1], has_global_noise=False
    )
    model = LCM(X, Y, likelihood, n_latent).to(dtype)
    likelihood.to(dtype).initialize(task_noises=torch.full((Y.shape[1],), noise, dtype=dtype))
    for kernel in model.covar_module.covar_module_list:
        kernel.data_covar_module.lengthscale = length_scale
    return model, likelihood


def cholesky():
    """Return the settings in which everything is done by Cholesky factorisation."""
    return gpytorch.settings.fast_computations(
        covar_root_decomposition=False, log_prob=False, solves=False
    )


def likelihood_and_gradient(model, likelihood):
    """Return a function that evaluates the log marginal likelihood and its gradient once."""
    model.train()
    likelihood.train()
    objective = gpytorch.mlls.ExactMarginalLogLikelihood(likelihood, model)

    def evaluate():
        model.zero_grad()
        value = objective(model(*model.train_inputs), model.train_targets)
        value.backward()
        return value.item() * model.train_targets.numel()

    return evaluate


def gradient(model, likelihood):
    """Return the gradient by all parameters, as one array, in double precision."""
    likelihood_and_gradient(model, likelihood)()
    grads = [parameter.grad for parameter in model.parameters()]
    return np.concatenate([g.double().numpy().ravel() for g in grads if g is not None])


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


def train_variational(X, Y, *, n_latent=6, n_inducing=150, batch=512, rate=0.02, seed=0):
    """Maximise the evidence lower bound by Adam; yield the predictor after each step, without end."""
    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    starts = [X[rng.choice(len(X), n_inducing, replace=False)] for _ in range(n_latent)]
    X, Y = torch.as_tensor(X, dtype=torch.float32), torch.as_tensor(Y, dtype=torch.float32)
    model = Variational(torch.as_tensor(np.stack(starts), dtype=torch.float32), Y.shape[1])
    likelihood = gpytorch.likelihoods.MultitaskGaussianLikelihood(num_tasks=Y.shape[1])
    model.train()
    likelihood.train()
    objective = gpytorch.mlls.VariationalELBO(likelihood, model, num_data=len(Y))
    optimizer = torch.optim.Adam([*model.parameters(), *likelihood.parameters()], lr=rate)
    predictor = Predictor(model, likelihood)
    while True:
        for rows in torch.randperm(len(X)).split(batch):
            optimizer.zero_grad()
            (-objective(model(X[rows]), Y[rows])).backward()
            optimizer.step()
            yield predictor


class Predictor:
    """What a model in training knows now; it is left as it was: in training."""

    def __init__(self, model, likelihood):
        self.model, self.likelihood = model, likelihood

    def __call__(self, X):
        """Return the mean (n, P)."""
        return self._of_parts(X, lambda posterior: posterior.mean)

    def bands(self, X):
        """Return the standard deviations of the function and of a measurement, each (n, P)."""
        variance = self._of_parts(X, lambda posterior: posterior.variance)
        noise = (self.likelihood.task_noises + self.likelihood.noise).detach().double().numpy()
        return np.sqrt(variance), np.sqrt(variance + noise)

    def _of_parts(self, X, moment, rows=2048):
        self.model.eval()
        with torch.no_grad():
            parts = torch.as_tensor(X, dtype=torch.float32).split(rows)
            values = torch.cat([moment(self.model(part)) for part in parts]).double().numpy()
        self.model.train()
        return values
