"""The gradient step of DDPG without autograd: the learner is what limits training.

What it computes is what Stable-Baselines3's `DDPG.train` does; where it is faster: the products between two hidden
layers, nine tenths of the work, in bfloat16; no gradients of the critic's weights while the actor learns; fused Adam;
target networks that follow in one call.
"""

import torch
from stable_baselines3 import DDPG
from stable_baselines3.common.type_aliases import ReplayBufferSamples
from torch import Tensor, nn
from torch.optim.adam import adam

DTYPES = {"fp32": torch.float32, "bf16": torch.bfloat16}


class _Mlp:
    """Forward and backward pass of linear layers with ReLU between; shares its weights with the module it is made of.

    Args:
        module: Linear and ReLU by turns, a Tanh at the end or not (then `forward` gives what goes into it).
        dtype: of the products between two hidden layers.
    """

    def __init__(self, module: nn.Module, dtype: torch.dtype) -> None:
        linear = [layer for layer in module.modules() if isinstance(layer, nn.Linear)]
        self.weights = [layer.weight.data for layer in linear]
        self.biases = [layer.bias.data for layer in linear]
        self._gradients = [(torch.zeros_like(layer.weight), torch.zeros_like(layer.bias)) for layer in linear]
        for layer, gradients in zip(linear, self._gradients, strict=True):
            layer.weight.grad, layer.bias.grad = gradients
        self._inner = range(1, len(linear) - 1)
        self._dtype = dtype
        self._low = {i: self.weights[i].to(dtype) for i in self._inner}

    @property
    def tensors(self) -> list[Tensor]:
        """All weights and biases."""
        return [*self.weights, *self.biases]

    def changed(self) -> None:
        """Must be called after the weights were."""
        for i, low in self._low.items():
            low.copy_(self.weights[i])

    def forward(self, x: Tensor) -> Tensor:
        """Return (B, n_out) for (B, n_in), and keep what `backward` needs."""
        self._inputs = [x]
        self._low_inputs: dict[int, Tensor] = {}
        last = len(self.weights) - 1
        for i, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            if i in self._low:
                self._low_inputs[i] = x.to(self._dtype)
                x = torch.mm(self._low_inputs[i], self._low[i].t()).float().add_(bias)
            else:
                x = torch.addmm(bias, x, weight.t())
            if i < last:
                x.relu_()
                self._inputs.append(x)
        return x

    def backward(self, gradient: Tensor) -> None:
        """Set the gradients of the weights, given that of the output."""
        for i in reversed(range(len(self.weights))):
            of_weight, of_bias = self._gradients[i]
            torch.sum(gradient, 0, out=of_bias)
            if i in self._low:
                of_weight.copy_(torch.mm(gradient.to(self._dtype).t(), self._low_inputs[i]))
            else:
                torch.mm(gradient.t(), self._inputs[i], out=of_weight)
            if i > 0:
                gradient = self._before(i, gradient)

    def slope(self, gradient: Tensor, n_last: int) -> Tensor:
        """Return the gradient of the last few columns of the input, given that of the output."""
        for i in reversed(range(1, len(self.weights))):
            gradient = self._before(i, gradient)
        return torch.mm(gradient, self.weights[0][:, -n_last:])

    def _before(self, i: int, gradient: Tensor) -> Tensor:
        """Return the gradient of what goes into the ReLU before layer i, given that of what comes out of the layer."""
        low = gradient.to(self._dtype) if i in self._low else gradient
        back = torch.mm(low, self._low.get(i, self.weights[i])).float()
        return torch.ops.aten.threshold_backward(back, self._inputs[i], 0.0)


class _Adam:
    """The steps of a fused Adam of torch, without what `step` does around them (as long as the step itself).

    Args:
        optimizer: whose state this moves on.
    """

    def __init__(self, optimizer: torch.optim.Optimizer) -> None:
        self._optimizer = optimizer

    def step(self) -> None:
        """Step, at the rate that the optimizer has now."""
        optimizer = self._optimizer
        if not optimizer.state:
            optimizer.step()  # makes the state
            return
        (group,) = optimizer.param_groups
        parameters = group["params"]
        states = [optimizer.state[parameter] for parameter in parameters]
        adam(
            parameters,
            [parameter.grad for parameter in parameters],
            exp_avgs=[state["exp_avg"] for state in states],
            exp_avg_sqs=[state["exp_avg_sq"] for state in states],
            max_exp_avg_sqs=[],
            state_steps=[state["step"] for state in states],
            beta1=group["betas"][0],
            beta2=group["betas"][1],
            **{key: group[key] for key in ("lr", "weight_decay", "eps", "amsgrad", "maximize", "fused")},
        )


class DDPGUpdate:
    """Gradient steps on the networks of a DDPG model.

    Args:
        model: whose networks and optimizers these are; it may be saved and loaded as ever.
        precision: a key of `DTYPES`.
        cloning: weight of the mean squared distance to the replay's actions, against Q as a share of its mean size.
    """

    def __init__(self, model: DDPG, precision: str, cloning: float = 0.0) -> None:
        dtype = DTYPES[precision]
        self._model, self._cloning = model, cloning
        self._actor, self._actor_target = _Mlp(model.actor.mu, dtype), _Mlp(model.actor_target.mu, dtype)
        self._critic, self._critic_target = (
            _Mlp(critic.q_networks[0], dtype) for critic in (model.critic, model.critic_target)
        )
        self._actor_adam, self._critic_adam = _Adam(model.actor.optimizer), _Adam(model.critic.optimizer)

    @torch.no_grad()
    def critic_step(self, batch: ReplayBufferSamples) -> Tensor:
        """Fit the critic to r + gamma Q'(s', mu'(s')) of the target networks; return the loss."""
        after = batch.next_observations
        action_after = torch.tanh(self._actor_target.forward(after))
        q_after = self._critic_target.forward(torch.cat([after, action_after], 1))
        goal = batch.rewards + (1.0 - batch.dones) * self._model.gamma * q_after
        error = self._critic.forward(torch.cat([batch.observations, batch.actions], 1)) - goal
        self._critic.backward(error * (2.0 / len(error)))
        self._critic_adam.step()
        self._critic.changed()
        return error.square().mean()

    @torch.no_grad()
    def actor_step(self, batch: ReplayBufferSamples) -> None:
        """Move the actor up the critic's slope, and towards the replay's actions where it is to stay near them."""
        action = torch.tanh(self._actor.forward(batch.observations))
        values = self._critic.forward(torch.cat([batch.observations, action], 1))
        upwards = torch.full((len(action), 1), -1.0 / len(action))
        slope = self._critic.slope(upwards, action.shape[1])
        if self._cloning:
            slope += (action - batch.actions) * (self._cloning * values.abs().mean() / len(action))
        self._actor.backward(slope * (1.0 - action.square()))
        self._actor_adam.step()
        self._actor.changed()

    @torch.no_grad()
    def follow(self) -> None:
        """Move the target networks after theirs."""
        followers, leaders = (self._actor_target, self._critic_target), (self._actor, self._critic)
        torch._foreach_lerp_(
            [tensor for net in followers for tensor in net.tensors],
            [tensor for net in leaders for tensor in net.tensors],
            self._model.tau,
        )
        for net in followers:
            net.changed()
