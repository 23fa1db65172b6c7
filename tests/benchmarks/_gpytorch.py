"""GPyTorch's models as its own examples build them: the exact LCM, and sparse variational ones of several outputs."""

from __future__ import annotations

import time

import gpytorch
import numpy as np
import torch
from gpytorch.variational import (
    CholeskyVariationalDistribution,
    LMCVariationalStrategy,
    NaturalVariationalDistribution,
    VariationalStrategy,
)
from sklearn.cluster import MiniBatchKMeans


class LCM(gpytorch.models.ExactGP):
    """The linear model of coregionalisation: as many RBF kernels, each with its own coregionalisation of rank 1."""

    def __init__(self, X, Y, likelihood, n_latent):
        super().__init__(X, Y, likelihood)
        d, P = X.shape[1], Y.shape[1]
        self.mean_module = gpytorch.means.MultitaskMean(gpytorch.means.ConstantMean(), num_tasks=P)
        kernels = [gpytorch.kernels.RBFKernel(ard_num_dims=d) for _ in range(n_latent)]
        self.covar_module = gpytorch.kernels.LCMKernel(kernels, num_tasks=P, rank=1)

    def forward(self, x):
        return gpytorch.distributions.MultitaskMultivariateNormal(self.mean_module(x), self.covar_module(x))


def exact_lcm(X, Y, n_latent, *, length_scale=1.0, noise=0.1, dtype=torch.float64):
    """Return model and likelihood at stated hyperparameters, the mixing drawn at random but always alike."""
    torch.manual_seed(0)
    X, Y = torch.as_tensor(X, dtype=dtype), torch.as_tensor(Y, dtype=dtype)
    likelihood = gpytorch.likelihoods.MultitaskGaussianLikelihood(num_tasks=Y.shape[1], has_global_noise=False)
    model = LCM(X, Y, likelihood, n_latent).to(dtype)
    likelihood.to(dtype).initialize(task_noises=torch.full((Y.shape[1],), noise, dtype=dtype))
    for kernel in model.covar_module.covar_module_list:
        kernel.data_covar_module.lengthscale = length_scale
    return model, likelihood


def cholesky():
    """Return the settings in which everything is done by Cholesky factorisation."""
    return gpytorch.settings.fast_computations(covar_root_decomposition=False, log_prob=False, solves=False)


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

    def __init__(self, Z, n_outputs, *, natural):
        L, m, d = Z.shape
        batch = torch.Size([L])
        distribution = NaturalVariationalDistribution if natural else CholeskyVariationalDistribution
        strategy = VariationalStrategy(self, Z, distribution(m, batch_shape=batch), learn_inducing_locations=True)
        super().__init__(LMCVariationalStrategy(strategy, num_tasks=n_outputs, num_latents=L, latent_dim=-1))
        self.mean_module = gpytorch.means.ConstantMean(batch_shape=batch)
        rbf = gpytorch.kernels.RBFKernel(ard_num_dims=d, batch_shape=batch)
        self.covar_module = gpytorch.kernels.ScaleKernel(rbf, batch_shape=batch)

    def forward(self, x):
        return gpytorch.distributions.MultivariateNormal(self.mean_module(x), self.covar_module(x))


def train_variational(
    X,
    Y,
    *,
    n_latent=6,
    n_inducing=150,
    batch=512,
    rate=0.02,
    decay=None,
    natural=0.0,
    kmeans=False,
    seed=0,
    length_scale=None,
):
    """Maximise the evidence lower bound by stochastic steps; yield (step, predictor) after each, without end.

    Parameters
    ----------
    n_latent : int
        Latents of the linear model of coregionalisation.
    rate, decay : float
        Of Adam; after ``decay`` steps the rate is a tenth.
    natural : float
        Step of natural gradients for the variational parameters; 0: Adam for these too.
    """
    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    centres = MiniBatchKMeans(n_inducing, n_init=1, random_state=seed).fit(X).cluster_centers_ if kmeans else None
    starts = [centres if kmeans else X[rng.choice(len(X), n_inducing, replace=False)] for _ in range(n_latent)]
    X, Y = torch.as_tensor(X, dtype=torch.float32), torch.as_tensor(Y, dtype=torch.float32)
    Z = torch.as_tensor(np.stack(starts), dtype=torch.float32)
    model = Variational(Z, Y.shape[1], natural=natural > 0)
    likelihood = gpytorch.likelihoods.MultitaskGaussianLikelihood(num_tasks=Y.shape[1])
    if length_scale is not None:
        model.covar_module.base_kernel.lengthscale = length_scale
    model.train()
    likelihood.train()
    objective = gpytorch.mlls.VariationalELBO(likelihood, model, num_data=len(Y))
    slow = list(model.hyperparameters() if natural else model.parameters()) + list(likelihood.parameters())
    optimizers = [torch.optim.Adam(slow, lr=rate)]
    if natural:
        optimizers.append(gpytorch.optim.NGD(model.variational_parameters(), num_data=len(Y), lr=natural))
    schedule = decay and torch.optim.lr_scheduler.ExponentialLR(optimizers[0], 0.1 ** (1 / decay))
    step, predictor = 0, Predictor(model, likelihood)
    while True:
        for rows in torch.randperm(len(X)).split(batch):
            for optimizer in optimizers:
                optimizer.zero_grad()
            (-objective(model(X[rows]), Y[rows])).backward()
            for optimizer in optimizers:
                optimizer.step()
            if schedule:
                schedule.step()
            step += 1
            yield step, predictor


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


def clocked(steps, seconds):
    """Yield (seconds, step, predict) at each of the given seconds of training; what happens between is not counted."""
    spent, targets = 0.0, list(seconds)
    while targets:
        start = time.perf_counter()
        step, predictor = next(steps)
        spent += time.perf_counter() - start
        if spent >= targets[0]:
            targets.pop(0)
            yield spent, step, predictor
