# SPDX-License-Identifier: Apache-2.0
"""DGAN-KPN in PyTorch against the paper (Symmetry 14, 395), by equation and section number."""

from __future__ import annotations

import dataclasses
import math

import pytest

torch = pytest.importorskip("torch", reason="training needs PyTorch, which the product's tests do not install")

from training.dgan import config as settings  # noqa: E402
from training.dgan.config import DganKpnConfig, DiscriminatorConfig, GeneratorConfig, KpnConfig, LossFactors  # noqa: E402
from training.dgan.discriminator import Discriminators  # noqa: E402
from training.dgan.generator import Generator, generate, instance_norm, mirror_index  # noqa: E402
from training.dgan.kpn import Kpn  # noqa: E402
from training.dgan.losses import adversarial_loss, kernel_loss, tone_loss, total_loss  # noqa: E402
from training.dgan.model import DganKpn  # noqa: E402
from training.dgan.reconstruct import iterate_filter, normalise_kernels, reconstruct, reconstruct_reference  # noqa: E402

TINY = DganKpnConfig(
    GeneratorConfig(widths=(16, 16, 16, 16), decoder=(16, 16, 16, 16), deviation=0.1),
    KpnConfig(width=16, blocks=1, predictor=16),
    DiscriminatorConfig(width=4),
)


@pytest.fixture(autouse=True)
def seeded() -> None:
    torch.manual_seed(11)


def image(*shape: int) -> torch.Tensor:
    return torch.rand(*shape) * 4


# ---- Section 3.1.3 --------------------------------------------------------------------------------------------------


def test_equation_1_weights_are_in_0_1_and_sum_to_1() -> None:
    logits = torch.randn(2, 361, 3, 4) * 50
    kernels = normalise_kernels(logits)
    assert kernels.min() >= 0 and kernels.max() <= 1
    assert torch.allclose(kernels.sum(1), torch.ones(2, 3, 4), atol=1e-5)
    p = logits[1, :, 2, 3].double()
    want = [math.exp(v - p.max()) for v in p]
    assert torch.allclose(kernels[1, :, 2, 3].double(), torch.tensor(want).double() / sum(want), atol=1e-6)


def test_equation_2_pixel_by_pixel() -> None:
    z, logits = image(1, 3, 12, 23), torch.randn(1, 361, 12, 23)
    got = reconstruct_reference(z, logits)
    for y, x in ((0, 0), (5, 11), (11, 22), (3, 1)):
        total, weights = torch.zeros(3).double(), 0.0
        for k in range(361):
            v, u = y + k // 19 - 9, x + k % 19 - 9
            if 0 <= v < 12 and 0 <= u < 23:  # outside the image: dropped, the rest weighed anew
                w = math.exp(float(logits[0, k, y, x]))
                total += w * z[0, :, v, u].double()
                weights += w
        assert torch.allclose(got[0, :, y, x].double(), total / weights, atol=1e-5)


def test_equation_2_native_kernel_and_its_gradient_agree_with_plain_pytorch() -> None:
    z, logits = image(2, 3, 20, 21).requires_grad_(), torch.randn(2, 361, 20, 21).requires_grad_()
    weight = torch.randn(2, 3, 20, 21)
    results = []
    for function in (reconstruct, reconstruct_reference):
        out = function(z, logits)
        results.append((out.detach(), *torch.autograd.grad((out * weight).sum(), (z, logits))))
    for got, want in zip(*results, strict=True):
        assert torch.allclose(got, want, atol=2e-5)


def test_reconstruction_keeps_constants_and_range() -> None:
    logits = torch.randn(1, 361, 9, 9)
    assert torch.allclose(iterate_filter(torch.full((1, 3, 9, 9), 0.7), logits, 8), torch.full((1, 3, 9, 9), 0.7))
    z = image(1, 3, 9, 9)
    out = iterate_filter(z, logits, 4)
    assert out.min() >= z.min() - 1e-6 and out.max() <= z.max() + 1e-6


# ---- Sections 3.1.1 and 3.1.2: the networks --------------------------------------------------------------------------


def test_published_generator() -> None:
    generator = Generator(settings.published().generator)
    encoder = [layer.conv for layer in generator.encoder]
    assert [(c.out_channels, c.kernel_size, c.stride) for c in encoder] == [
        (n, (3, 3), (2, 2)) for n in (64, 128, 256, 512)
    ]
    residual = [c for block in generator.blocks for c in (block.first.conv, block.second.conv)]
    assert [(c.in_channels, c.out_channels, c.stride) for c in residual] == [(512, 512, (1, 1))] * 4  # layers 5 to 8
    # Symmetric, and skips: each upsampling sees the encoder's tensor of its size.
    assert [layer.conv.in_channels for layer in generator.decoder] == [512 + 512, 256 + 256, 128 + 128, 64 + 64]
    assert generator.last.out_channels == 3
    assert generator(image(1, 3, 32, 48)).shape == (1, 3, 32, 48)
    deviations = [p.std().item() for name, p in generator.named_parameters() if name.endswith("conv.weight")]
    assert all(0.0019 < d < 0.0021 for d in deviations)  # section 3.3: Gaussian of deviation 0.002


def test_each_generator_layer_is_convolution_instance_norm_relu() -> None:
    layer = Generator(TINY.generator).encoder[1]
    x = torch.randn(2, 16, 16, 24)
    want = torch.relu(torch.nn.functional.instance_norm(layer.conv(x), eps=1e-5))
    assert torch.allclose(layer(x), want, atol=1e-5)
    assert torch.equal(instance_norm(torch.ones(1, 4, 1, 1)), torch.zeros(1, 4, 1, 1))


def test_published_kernel_predictor() -> None:
    kpn = Kpn(settings.published().kpn)
    assert kpn.source_first.in_channels == 13  # section 3.2
    assert kpn.source_first.kernel_size == kpn.source_second.kernel_size == (5, 5)
    assert [(c.kernel_size, c.stride, c.out_channels) for c in kpn.predictor] == [((1, 1), (1, 1), 361)] * 3
    for name, p in kpn.named_parameters():  # section 3.3: Xavier, bias 0
        if name.endswith("bias"):
            assert p.abs().max() == 0
        else:
            fan = (p.shape[0] + p.shape[1]) * p[0, 0].numel()
            assert p.abs().max() <= math.sqrt(6 / fan) + 1e-6
    assert kpn(torch.randn(1, 13, 6, 5)).shape == (1, 361, 6, 5)


def test_four_discriminators_of_different_scales() -> None:
    maps = Discriminators(DiscriminatorConfig(width=8))(image(1, 3, 64, 64), image(1, 3, 64, 64))
    assert len(maps) == 4
    sizes = [m.shape[-1] for m in maps]
    assert sizes == sorted(sizes, reverse=True) and len(set(sizes)) == 4
    assert all(m.abs().max() <= 1 for m in maps)


# ---- Section 3.1.4: losses -------------------------------------------------------------------------------------------


def test_equation_6_and_7() -> None:
    critics = Discriminators(TINY.discriminator)
    z, g, estimate = image(1, 3, 32, 32), image(1, 3, 32, 32), image(1, 3, 32, 32)
    real, fake = critics(z, g), critics(z, estimate)
    want = sum(float((r - f).detach().abs().sum(1).mean()) for r, f in zip(real, fake, strict=True))
    assert float(adversarial_loss(real, fake).detach()) == pytest.approx(want, rel=1e-5)
    assert float(adversarial_loss(real, critics(z, g)).detach()) == 0.0


def make_trainer(stage: str):
    from training.dgan.data import Batch
    from training.dgan.train import TrainConfig, Trainer

    trainer = Trainer(TrainConfig(stage=stage, model=TINY, iterations=2, bfloat16=False, steps=100, rate=1e-3))
    batch = Batch(
        image(1, 3, 32, 32),
        image(1, 3, 32, 32),
        torch.randn(1, 13, 32, 32),
        torch.zeros(1),
        torch.zeros(0),
        torch.zeros(0),
    )
    return trainer, batch


@pytest.mark.parametrize("stage", ["dgan", "joint"])
def test_equations_3_to_5_discriminators_rise_then_the_generator_falls(stage: str) -> None:
    trainer, batch = make_trainer(stage)
    estimate = trainer.estimate(batch).detach()
    before = float(trainer.judge(batch, estimate).detach())
    trainer.descend(trainer.critic, -trainer.judge(batch, estimate))
    risen = float(trainer.judge(batch, estimate).detach())
    assert risen > before
    fixed = [p.clone() for p in trainer.discriminators.parameters()]
    for _ in range(3):
        trainer.descend(trainer.optimiser, trainer.judge(batch, trainer.estimate(batch)))
    assert float(trainer.judge(batch, trainer.estimate(batch)).detach()) < risen
    assert all(torch.equal(a, b) for a, b in zip(fixed, trainer.discriminators.parameters(), strict=True))


def test_equation_8() -> None:
    z, g = image(1, 3, 4, 5), image(1, 3, 4, 5)
    want = sum(float((z[0, :, y, x] - g[0, :, y, x]).abs().sum()) for y in range(4) for x in range(5)) / 20
    assert float(kernel_loss(z, g)) == pytest.approx(want, rel=1e-5)


def test_equation_9() -> None:
    z, g = image(1, 3, 4, 5), image(1, 3, 4, 5)
    want = float((z / (1 + z) - g / (1 + g)).abs().sum()) / 20
    assert float(tone_loss(z, g)) == pytest.approx(want, rel=1e-5)


def test_equation_10() -> None:
    one = torch.ones(())
    assert dataclasses.astuple(LossFactors()) == (0.003, 0.008, 0.09)
    assert float(total_loss(2 * one, 3 * one, 5 * one, LossFactors())) == pytest.approx(0.006 + 0.024 + 0.45)


def test_phase_1_of_the_kernel_predictor_sees_the_noisy_image_and_equation_8_alone() -> None:
    trainer, batch = make_trainer("kpn")
    estimate = trainer.estimate(batch)
    assert torch.allclose(estimate, reconstruct(batch.noisy, trainer.model.kpn(batch.auxiliary)))
    assert torch.equal(trainer.loss(batch, estimate), kernel_loss(estimate, batch.target))
    before = [p.clone() for p in trainer.model.generator.parameters()]
    trainer.step(batch, 0)
    assert all(torch.equal(a, b) for a, b in zip(before, trainer.model.generator.parameters(), strict=True))


def test_phase_1_of_the_generator_has_equation_6_alone() -> None:
    trainer, batch = make_trainer("dgan")
    estimate = trainer.estimate(batch)
    assert torch.allclose(estimate, generate(trainer.model.generator, batch.noisy, batch.exponent))
    assert torch.equal(trainer.loss(batch, estimate), trainer.judge(batch, estimate))


def test_phase_2_trains_both_with_equation_10() -> None:
    trainer, batch = make_trainer("joint")
    estimate = trainer.estimate(batch)
    parts = trainer.judge(batch, estimate), kernel_loss(estimate, batch.target), tone_loss(estimate, batch.target)
    assert float(trainer.loss(batch, estimate).detach()) == pytest.approx(
        float(total_loss(*parts, LossFactors()).detach())
    )
    before = {name: p.clone() for name, p in trainer.model.named_parameters()}
    trainer.step(batch, 0)
    moved = {name.partition(".")[0] for name, p in trainer.model.named_parameters() if not torch.equal(p, before[name])}
    assert moved == {"generator", "kpn"}


def test_section_3_3_optimiser_and_schedule() -> None:
    from training.dgan.train import TrainConfig, rate_at

    config = TrainConfig(steps=400)
    assert config.rate == 1e-4 and config.data.batch == 1 and config.iterations == 4
    assert [rate_at(s, config) for s in (0, 100, 200)] == [1e-4] * 3
    assert rate_at(300, config) == pytest.approx(0.5e-4) and rate_at(400, config) == 0
    group = make_trainer("kpn")[0].optimiser.param_groups[0]
    assert group["betas"] == (0.9, 0.999) and group["eps"] == 1e-8


# ---- Iterations ------------------------------------------------------------------------------------------------------


def test_both_readings_of_the_iterations() -> None:
    model = DganKpn(TINY).eval()
    z, auxiliary, exponent = image(1, 3, 20, 17), torch.randn(1, 13, 20, 17), torch.zeros(1)
    logits = model.kpn(auxiliary)

    def g(x: torch.Tensor) -> torch.Tensor:
        return generate(model.generator, x, exponent)

    def k(x: torch.Tensor) -> torch.Tensor:
        return reconstruct(x, logits)

    with torch.no_grad():
        assert torch.allclose(model(z, auxiliary, exponent, 3), k(k(k(g(z)))), atol=1e-5)
        assert torch.allclose(model(z, auxiliary, exponent, 2, reading="network"), k(g(k(g(z)))), atol=1e-5)
        assert torch.allclose(model(z, auxiliary, exponent, 2, "kpn"), k(k(z)), atol=1e-5)
        assert torch.allclose(model(z, auxiliary, exponent, 1, "dgan"), g(z), atol=1e-5)
    for wrong in ({"iterations": 0}, {"iterations": 9}, {"parts": "none"}, {"reading": "twice"}):
        with pytest.raises(ValueError):
            model(z, auxiliary, exponent, **wrong)


def test_scaling_by_a_power_of_two_is_exact() -> None:
    model = DganKpn(TINY)
    z, auxiliary = image(1, 3, 16, 16), torch.randn(1, 13, 16, 16)
    with torch.no_grad():
        once = model(z, auxiliary, torch.zeros(1))
        again = model(z * 8, auxiliary, torch.full((1,), 3.0))
    assert torch.allclose(once * 8, again, rtol=1e-6)


def test_mirror_padding_of_any_size() -> None:
    assert mirror_index(1, 4).tolist() == [0, 0, 0, 0]
    assert mirror_index(3, 8).tolist() == [0, 1, 2, 1, 0, 1, 2, 1]
    assert generate(Generator(TINY.generator), image(1, 3, 1, 1), torch.zeros(1)).shape == (1, 3, 1, 1)


# ---- Section 3.2 -----------------------------------------------------------------------------------------------------


def test_thirteen_auxiliary_channels() -> None:
    from training.dgan.features import Auxiliary, box_position, make_auxiliary

    depth = torch.full((1, 1, 4, 4), 3.0)
    depth[..., 0, 0] = 1e10
    hit = (depth < 1e9)[0]
    boxed = box_position(torch.randn(3, 4, 4) * 50 + 9, hit)
    assert boxed.abs().max() == pytest.approx(1) and boxed[:, 0, 0].abs().max() == 0
    three = torch.rand(1, 3, 4, 4)
    planes = make_auxiliary(Auxiliary(three, boxed[None], three, three, depth), torch.ones(1), three)
    assert planes.shape == (1, 13, 4, 4)
    assert planes[0, 12, 0, 0] == -1 and planes[0, 12, 1, 1] == pytest.approx(1 / 2.5)
    assert make_auxiliary(Auxiliary(None, None, None, None, None), torch.ones(1), three).abs().max() == 0


def test_unknown_settings_are_errors() -> None:
    assert settings.from_json(dataclasses.asdict(settings.published())) == settings.published()
    with pytest.raises(TypeError):
        settings.from_json({"kpn": {"depth": 3}})
