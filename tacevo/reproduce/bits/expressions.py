"""Every operation that a candidate may call, as expressions to be computed on many values and on several CPUs.

`tacevo.reproduce.bits.operations.operands` makes the operands; names are those that a candidate's text sees. Torch's
generator is seeded before each, so layers and random draws are the same every time.
"""

import re
from collections.abc import Iterator

#: Element-wise functions of `torch`, by the operand that suits them: 300,001 values from -8 to 8 (X), from 0.001 to
#: 50 (P), from -1 to 1 (L). A few thousand are not enough: `acos` differs between CPUs in few places.
_UNARY = {
    "X": """
        abs absolute arctan asinh atan ceil cos cosh deg2rad erf erfc exp exp2 expm1 frac floor neg negative positive
        rad2deg relu round rsub selu sgn sigmoid sign sin sinc sinh square tan tanh trunc nan_to_num isfinite isinf
        isnan hardshrink celu rrelu conj real angle
    """,
    "P": "digamma lgamma log log10 log1p log2 reciprocal rsqrt sqrt",
    "1 + P": "acosh",
    "L": "acos arccos arcsin asin",
    "0.999 * L": "atanh erfinv",
    "0.5 + 0.49 * L": "logit",
}

#: Those of them that come from a mathematics library, which has other code for float64.
_TRANSCENDENTAL = """
    acos acosh asin asinh atan atanh cos cosh digamma erf erfc erfinv exp expm1 lgamma log log10 log1p log2 rsqrt sin
    sinh sqrt tan tanh
"""

#: Functions of `torch` that are MKL's where they write into another tensor.
_INTO = {"acos": "L", "asin": "L", "atan": "X", "sqrt": "P"}

#: Functions of `torch` of two operands of one shape.
_BINARY = """
    add atan2 copysign div divide true_divide dist eq equal float_power fmax fmin fmod ge greater
    greater_equal gt hypot isclose allclose ldexp le less less_equal lt logaddexp logaddexp2 maximum minimum mul
    multiply ne not_equal pow remainder sub subtract xlogy cosine_similarity pairwise_distance
    logical_and logical_or logical_xor
"""

#: Functions of `torch` that take a tensor and an axis.
_ALONG_AXIS = """
    all any amax amin aminmax argmax argmin argsort cummax cummin cumprod cumsum diff gradient log_softmax
    logcumsumexp logsumexp max mean median min mode nanmean nanmedian nansum norm prod softmax sort std std_mean sum
    trapezoid unbind var var_mean
"""

#: Elementary functions of a plain number, times a tensor: a constant of a network.
_MATH = "acos asin atan cos cosh erf erfc exp expm1 gamma lgamma log log10 log1p log2 sin sinh sqrt tan tanh"

#: Calls that are alike but for the name, which takes the place of `{}`.
_CALLS = {
    "torch.special.{}(x)": "ndtr expit erf erfc sinc expm1 exp2",
    "torch.{}(torch.polar(p, x))": "view_as_real imag real",
    "torch.special.{}(p)": "entr gammaln digamma log1p",
    "torch.special.{}(x, 1)": "softmax log_softmax logsumexp",
    "torch.{}(x)": "norm std var mean sum msort count_nonzero logical_not fliplr flipud",
    "torch.{}(m[0])": "cov diag trace",
    "torch.{}(m[0], m[1])": "mm inner block_diag",
    "torch.{}(m)": "det slogdet inverse tril triu",
    "torch.linalg.{}(m)": "norm matrix_norm svdvals qr inv pinv det slogdet",
    "torch.linalg.{}(h)": "eigh eigvalsh cholesky",
    "torch.fft.{}(x)": "fft fftshift ifftshift ifft rfft hfft ihfft",
    "torch.fft.{}(i)": "fft2 fftn ifft2 ifftn rfft2 rfftn hfft2 hfftn ihfft2 ihfftn",
    "torch.{}([x, y])": "cat concat concatenate stack hstack vstack dstack column_stack",
    "torch.{}(i, 2)": "pixel_shuffle pixel_unshuffle channel_shuffle group_norm max_pool2d",
    "F.{}(x)": """
        relu relu6 hardtanh hardswish elu selu leaky_relu glu gelu logsigmoid hardshrink softshrink tanhshrink
        softsign softplus tanh sigmoid hardsigmoid silu mish
    """,
    "F.{}(x * 1)": "relu_ hardtanh_ elu_ selu_ celu_ leaky_relu_ rrelu_",
    "F.{}(x, 1)": "softmin softmax log_softmax",
    "F.{}(x, y)": "pairwise_distance cosine_similarity mse_loss l1_loss smooth_l1_loss huber_loss",
    "F.{}(i, scale_factor=2)": "interpolate upsample upsample_nearest upsample_bilinear",
    "F.{}(i, 2)": "pixel_shuffle pixel_unshuffle channel_shuffle",
    "nn.{}(3)(i)": "AdaptiveAvgPool2d AdaptiveMaxPool2d CrossMapLRN2d LocalResponseNorm",
    "nn.{}(2)(i)": "AvgPool2d ChannelShuffle PixelShuffle PixelUnshuffle",
    "nn.{}()(x)": """
        CELU ELU GELU GLU Hardshrink Hardsigmoid Hardswish Hardtanh Identity LogSigmoid Mish PReLU RReLU ReLU
        ReLU6 SELU SiLU Sigmoid Softplus Softshrink Softsign Tanh Tanhshrink
    """,
    "nn.{}()(x, y)": "CosineSimilarity HuberLoss L1Loss MSELoss PairwiseDistance SmoothL1Loss",
    "nn.{}(8, 10)(x[:, :8])": "GRUCell LSTMCell RNNCell",
    "nn.{}()(x, y, p)": "GaussianNLLLoss TripletMarginLoss TripletMarginWithDistanceLoss",
    "nn.{}(1)(x)": "LogSoftmax Softmax Softmin",
    "nn.{}(scale_factor=2)(i)": "Upsample UpsamplingBilinear2d UpsamplingNearest2d",
    "nn.init.{}(torch.empty(60, 80))": """
        kaiming_normal_ kaiming_uniform_ normal_ orthogonal_ uniform_ xavier_normal_ xavier_uniform_
    """,
}

#: All others of `torch`, with a semicolon between two.
_FURTHER = """
    torch.add(x, y, alpha=0.3); p ** 0.5; p ** -0.5; p ** 2; p ** 3; p ** 3.3; p ** 0.25; 2 ** x; p ** y; x % 1.7;
    x.detach() // 1.7; 1 / p; p.double().sqrt().float(); p.double().log().float(); x.double().exp().float();
    x.double().sin().float(); x.double().tanh().float(); x.double().atan().float(); p.half().sqrt().float();
    p.bfloat16().sqrt().float(); x.half().exp().float(); x.bfloat16().exp().float(); (p * 1).sqrt_(); (p * 1).rsqrt_();
    (u * 1).asin_(); torch.relu_(x * 1); torch.floor_divide(x.detach(), y.detach());
    torch.heaviside(x.detach(), y.detach()); torch.polar(p, x); torch.polar(p, x).abs(); torch.polar(p, x).angle();
    torch.polar(p, x).exp(); torch.polar(p, x).log(); torch.polar(p, x).sqrt(); torch.polar(p, x).acos();
    torch.polar(p, x).asin(); torch.polar(p, x).atan(); torch.polar(p, x).tan(); torch.polar(p, x) ** 0.5;
    torch.polar(p, x) * torch.polar(p, y);
    torch.polar(p, x) / torch.polar(p, y); torch.complex(x, y); torch.view_as_complex(x.view(20, 500, 2));
    p.detach().igamma(p.flip(0).detach()); x.sinc(); p.polygamma(1); p.mvlgamma(1); x.i0(); torch.special.erfinv(u);
    torch.special.logit(0.5 + 0.4 * u); torch.special.xlogy(x, p); torch.clamp(x, -1, 1); torch.clamp_max(x, 1);
    torch.clamp_min(x, 1); torch.clip(x, -1, 1); torch.lerp(x, y, 0.3); torch.addcdiv(x, y, p, value=0.3);
    torch.addcmul(x, y, p, value=0.3); torch.prelu(x, 0.2 * p[0, :1]); torch.threshold(x, 0.5, 0.1);
    torch.where(x > 0, x, y); torch.masked_fill(x, x > 0, 0.5); torch.masked_scatter(x, x > 0, y);
    torch.masked_select(x, x > 0); torch.renorm(m, 2, 0, 1.0); torch.norm(x, p=1, dim=1); torch.norm(x, p=3, dim=1);
    torch.prod(u); torch.quantile(x[:, :50], 0.3, dim=1); torch.kthvalue(x, 3, dim=1); torch.topk(x, 5, dim=1);
    torch.histc(x.detach(), 20); torch.unique(k); torch.bucketize(x, u[0].detach().sort()[0]);
    torch.searchsorted(u[0].detach().sort()[0], x); torch.isin(k, k[0, :5]); torch.nonzero(x[:2, :20] > 0);
    torch.cdist(s, s.flip(1)); torch.cdist(s, s.flip(1), p=1.0); torch.cdist(s, s.flip(1), p=3.0);
    torch.cross(x[:, :3], y[:, :3], dim=1); torch.matmul(m, m); torch.matmul(s, s.transpose(1, 2)); torch.bmm(m, m);
    torch.mv(m[0], m[1, 0]); torch.dot(x[0], y[0]); torch.vdot(x[0], y[0]); torch.outer(x[0, :40], y[0, :40]);
    torch.kron(m[0, :4, :4], m[1, :4, :4]); torch.addmm(m[0], m[1], m[2]); torch.addmv(m[0, 0], m[1], m[2, 0]);
    torch.addr(m[0], m[1, 0], m[2, 0]); torch.addbmm(m[0], m, m); torch.baddbmm(m, m, m);
    torch.chain_matmul(m[0], m[1], m[2]); torch.tensordot(m, m, dims=([2], [1])); torch.einsum('bij,bjk->bik', m, m);
    torch.einsum('bchw,cd->bdhw', i, m[0, :8, :8]); torch.matrix_power(m, 3); torch.matrix_exp(0.1 * m);
    torch.logdet(h); torch.linalg.norm(m, ord=2, dim=(1, 2)); torch.linalg.vector_norm(x, dim=1);
    torch.linalg.vector_norm(x, ord=3, dim=1); torch.linalg.matrix_norm(m, ord='nuc');
    torch.linalg.svd(m, full_matrices=False)[1]; torch.linalg.svd(m, full_matrices=False);
    torch.linalg.solve(m, m[:, :1].transpose(1, 2)); torch.linalg.lstsq(m, m[:, :1].transpose(1, 2)).solution;
    torch.linalg.matmul(m, m); torch.linalg.vecdot(x, y); torch.linalg.multi_dot([m[0], m[1], m[2]]);
    torch.linalg.cross(x[:, :3], y[:, :3], dim=1); torch.linalg.matrix_exp(0.1 * m); torch.linalg.matrix_power(m, 2);
    torch.fft.fftfreq(17); torch.fft.rfftfreq(17); torch.fft.irfft(torch.fft.rfft(x));
    torch.fft.irfft2(torch.fft.rfft2(i)); torch.fft.irfftn(torch.fft.rfftn(i));
    torch.stft(x, 64, window=torch.hann_window(64), return_complex=True);
    torch.istft(torch.stft(x, 64, return_complex=True), 64); torch.hann_window(64); torch.hamming_window(64);
    torch.linspace(0.1, 7.3, 1000); torch.logspace(0.1, 1.3, 1000); torch.arange(0.1, 70, 0.07);
    torch.full((10,), 0.3) + torch.zeros(10) + torch.ones(10) + torch.scalar_tensor(0.5); torch.rand(20_000);
    torch.randn(20_000); torch.randn(7); torch.randint(0, 100, (1000,)); torch.randperm(1000);
    torch.normal(x.detach(), 0.5); torch.bernoulli(0.5 + 0.4 * u.detach()); torch.multinomial(p.detach(), 5);
    torch.rand_like(x) + torch.randn_like(x); x.detach().clone().exponential_(); x.detach().clone().log_normal_();
    x.detach().clone().cauchy_(); x.detach().clone().geometric_(0.3); torch.dropout(x, 0.3, True);
    torch.alpha_dropout(x, 0.3, True); torch.feature_dropout(i, 0.3, True); torch.roll(x, 3, 1); torch.flip(x, [1]);
    torch.rot90(m, 1, [1, 2]); torch.diag_embed(x[:, :10]); torch.diagonal(m, dim1=1, dim2=2); torch.take(x, k);
    torch.take_along_dim(x, k, 1); torch.gather(x, 1, k); torch.scatter(x, 1, k, y); torch.scatter_add(x, 1, k, y);
    torch.scatter_reduce(x, 1, k, y, 'amax'); torch.scatter_reduce(x, 1, k, y, 'mean');
    torch.index_add(x, 0, k[0, :20] % 20, y); torch.index_copy(x, 0, torch.arange(20).flip(0), y);
    torch.index_fill(x, 0, k[0, :5] % 20, 0.5); torch.index_select(x, 0, k[0, :30] % 20);
    torch.repeat_interleave(x[:, :20], 3, 1); torch.tile(x, (1, 2)); torch.cartesian_prod(x[0, :10], y[0, :10]);
    torch.combinations(x[0, :10]); torch.meshgrid(x[0, :10], y[0, :10], indexing='ij');
    torch.vander(u[0, :10].detach()); torch.tensor_split(x, 3);
    torch.batch_norm(i, w[:8], w[8:16], w[:8].detach(), p[0, :8].detach(), True, 0.1, 1e-5, False);
    torch.layer_norm(i, (12, 12)); torch.instance_norm(i, None, None, None, None, True, 0.1, 1e-5, False);
    torch.rms_norm(i, (12, 12)); torch.bilinear(x[:, :8], y[:, :8], torch.randn(5, 8, 8), None);
    torch.embedding(torch.randn(100, 8), k); torch.conv1d(s, torch.randn(6, 12, 3));
    torch.conv2d(i, torch.randn(6, 8, 3, 3)); torch.conv3d(d, torch.randn(6, 4, 3, 3, 3));
    torch.conv_transpose1d(s, torch.randn(12, 6, 3)); torch.conv_transpose2d(i, torch.randn(8, 6, 3, 3));
    torch.conv_transpose3d(d, torch.randn(4, 6, 3, 3, 3)); torch.avg_pool1d(s, 2); torch.max_pool1d(s, 2);
    torch.max_pool3d(d, 2); torch.adaptive_avg_pool1d(s, 3); torch.adaptive_max_pool1d(s, 3)
"""

#: All others of `torch.nn.functional`, `torch.nn` and its parts.
_LAYERS = """
    F.conv1d(s, torch.randn(6, 4, 3), groups=3); F.conv2d(i, torch.randn(8, 4, 5, 5), padding=2, groups=2);
    F.conv2d(i, torch.randn(8, 1, 3, 3), padding=1, groups=8); F.conv2d(i, torch.randn(8, 8, 1, 1), stride=2);
    F.conv3d(d, torch.randn(6, 4, 1, 3, 3)); F.conv_transpose1d(s, torch.randn(12, 6, 2), stride=2);
    F.conv_transpose2d(i, torch.randn(8, 6, 4, 4), stride=2);
    F.conv_transpose3d(d, torch.randn(4, 6, 2, 2, 2), stride=2); F.unfold(i, 3, padding=1);
    F.fold(torch.randn(4, 72, 144), (12, 12), 3, padding=1); F.linear(s, torch.randn(5, 8), torch.randn(5));
    F.bilinear(x[:, :8], y[:, :8], torch.randn(5, 8, 8)); F.avg_pool1d(s, 3, 2, 1); F.avg_pool2d(i, 3, 2, 1);
    F.avg_pool3d(d, 2); F.max_pool1d(s, 3, 2, 1); F.max_pool2d(i, 3, 2, 1); F.max_pool3d(d, 2);
    F.max_unpool1d(*F.max_pool1d(s, 2, return_indices=True), 2);
    F.max_unpool2d(*F.max_pool2d(i, 2, return_indices=True), 2);
    F.max_unpool3d(*F.max_pool3d(d, 2, return_indices=True), 2); F.lp_pool1d(s, 2, 2); F.lp_pool2d(i, 2, 2);
    F.lp_pool2d(i, 3, 2); F.lp_pool3d(d, 2, 2); F.fractional_max_pool2d(i, 2, output_ratio=(0.6, 0.6));
    F.fractional_max_pool3d(d, 2, output_ratio=(0.6, 0.6, 0.6)); F.adaptive_avg_pool1d(s, 3);
    F.adaptive_avg_pool2d(i, 5); F.adaptive_avg_pool3d(d, 3); F.adaptive_max_pool1d(s, 3); F.adaptive_max_pool2d(i, 5);
    F.adaptive_max_pool3d(d, 3); F.scaled_dot_product_attention(s, s, s);
    F.scaled_dot_product_attention(s.unsqueeze(1), s.unsqueeze(1), s.unsqueeze(1), dropout_p=0.2);
    F.multi_head_attention_forward(s, s, s, 8, 2, torch.randn(24, 8), w[:24], None, None, False, 0.0, s[0, :8], w[:8]);
    F.threshold(x, 0.5, 0.1); F.celu(x, 1.3); F.prelu(x, 0.2 * p[0, :1]); F.rrelu(x, training=True);
    F.gelu(x, approximate='tanh'); F.softplus(x, beta=2.5); F.softmax(i, 1); F.gumbel_softmax(x, dim=1);
    F.batch_norm(i, w[:8].detach(), p[0, :8].detach(), training=True);
    F.batch_norm(i, w[:8].detach(), p[0, :8].detach()); F.group_norm(i, 4); F.instance_norm(i); F.layer_norm(i, (12,));
    F.local_response_norm(i, 3); F.rms_norm(i, (12,)); F.normalize(i, dim=1); F.normalize(i, p=3.0, dim=1);
    F.dropout(x, 0.3); F.dropout1d(s, 0.3); F.dropout2d(i, 0.3); F.dropout3d(d, 0.3); F.alpha_dropout(x, 0.3, True);
    F.feature_alpha_dropout(i, 0.3, True); F.embedding(k, torch.randn(100, 8)); F.one_hot(k % 7); F.pdist(x[:, :20]);
    F.pad(i, (1, 2, 1, 1)); F.pad(i, (1, 2, 1, 1), mode='reflect'); F.pad(i, (1, 2, 1, 1), mode='replicate');
    F.pad(i, (1, 2, 1, 1), mode='circular'); F.interpolate(i, scale_factor=1.7, mode='bilinear');
    F.interpolate(i, size=(20, 17), mode='bicubic', align_corners=True); F.interpolate(i, size=(7, 5), mode='area');
    F.interpolate(i, size=(7, 5), mode='bilinear', antialias=True); F.interpolate(d, size=(7, 5, 5), mode='trilinear');
    F.interpolate(s, size=17, mode='linear'); F.grid_sample(i, g);
    F.grid_sample(i, g, mode='bicubic', padding_mode='reflection');
    F.affine_grid(torch.randn(4, 2, 3), (4, 8, 12, 12)); F.cross_entropy(x, k[:, 0]);
    F.nll_loss(F.log_softmax(x, 1), k[:, 0]); F.kl_div(F.log_softmax(x, 1), F.softmax(y, 1));
    F.binary_cross_entropy(torch.sigmoid(x), torch.sigmoid(y).detach());
    F.binary_cross_entropy_with_logits(x, torch.sigmoid(y).detach()); nn.AdaptiveAvgPool1d(3)(s);
    nn.AdaptiveAvgPool3d(3)(d); nn.AdaptiveMaxPool1d(3)(s); nn.AdaptiveMaxPool3d(3)(d);
    nn.AdaptiveLogSoftmaxWithLoss(8, 20, [5, 12])(x[:, :8], k[:, 0] % 20).loss; nn.AlphaDropout(0.3)(x);
    nn.AvgPool1d(2)(s); nn.AvgPool3d(2)(d); nn.BCELoss()(torch.sigmoid(x), torch.sigmoid(y).detach());
    nn.BCEWithLogitsLoss()(x, torch.sigmoid(y).detach()); nn.BatchNorm1d(12)(s); nn.BatchNorm2d(8)(i);
    nn.BatchNorm3d(4)(d); nn.Bilinear(8, 8, 5)(x[:, :8], y[:, :8]);
    nn.CTCLoss()(F.log_softmax(x[:, :400].view(20, 4, 100), 2), k[:4, :6] % 99 + 1, (20,) * 4, (6, 6, 5, 4));
    nn.CircularPad1d(2)(s) + nn.ReflectionPad1d(2)(s) + nn.ReplicationPad1d(2)(s);
    nn.ZeroPad1d(2)(s) + nn.ConstantPad1d(2, 0.5)(s);
    nn.CircularPad2d(2)(i) + nn.ReflectionPad2d(2)(i) + nn.ReplicationPad2d(2)(i);
    nn.ZeroPad2d(2)(i) + nn.ConstantPad2d(2, 0.5)(i);
    nn.CircularPad3d(2)(d) + nn.ReflectionPad3d(2)(d) + nn.ReplicationPad3d(2)(d);
    nn.ZeroPad3d(2)(d) + nn.ConstantPad3d(2, 0.5)(d); nn.Conv1d(12, 6, 3)(s); nn.Conv2d(8, 16, 3, padding=1)(i);
    nn.Conv2d(8, 16, 7, stride=2, padding=3)(i); nn.Conv2d(8, 16, 5, padding=2, bias=False)(i);
    nn.Conv2d(8, 16, 3, padding=2, dilation=2)(i); nn.Conv2d(8, 16, 3, padding=1, groups=8)(i);
    nn.Conv2d(8, 16, (1, 7), padding='same', padding_mode='reflect')(i); nn.Conv3d(4, 6, 3)(d);
    nn.ConvTranspose1d(12, 6, 3)(s); nn.ConvTranspose2d(8, 6, 2, 2)(i); nn.ConvTranspose3d(4, 6, 2, 2)(d);
    nn.CosineEmbeddingLoss()(x, y, torch.ones(20)); nn.CrossEntropyLoss(label_smoothing=0.1)(x, k[:, 0]);
    nn.Dropout(0.3)(x); nn.Dropout1d(0.3)(s); nn.Dropout2d(0.3)(i); nn.Dropout3d(0.3)(d); nn.Embedding(100, 8)(k);
    nn.EmbeddingBag(100, 8)(k); nn.FeatureAlphaDropout(0.3)(i); nn.Flatten()(i);
    nn.Fold((12, 12), 3, padding=1)(nn.Unfold(3, padding=1)(i)); nn.FractionalMaxPool2d(2, output_ratio=(0.6, 0.6))(i);
    nn.FractionalMaxPool3d(2, output_ratio=(0.6, 0.6, 0.6))(d); nn.GELU('tanh')(x);
    nn.GRU(8, 10, 2, batch_first=True, bidirectional=True)(s); nn.GroupNorm(4, 8)(i);
    nn.HingeEmbeddingLoss()(x, y.sign().detach()); nn.InstanceNorm1d(12, affine=True)(s);
    nn.InstanceNorm2d(8, affine=True)(i); nn.InstanceNorm3d(4, affine=True)(d);
    nn.KLDivLoss()(F.log_softmax(x, 1), F.softmax(y, 1)); nn.LPPool1d(2, 2)(s); nn.LPPool2d(2, 2)(i);
    nn.LPPool3d(2, 2)(d); nn.LSTM(8, 10, 2, batch_first=True)(s); nn.LayerNorm(12)(i); nn.LayerNorm([8, 12, 12])(i);
    nn.LeakyReLU(0.01)(x); nn.Linear(8, 60)(s); nn.Linear(1000, 300)(x);
    nn.LinearCrossEntropyLoss(8, 20)(x[:, :8], k[:, 0] % 20); nn.MarginRankingLoss()(x, y, x.sign().detach());
    nn.MaxPool1d(2)(s); nn.MaxPool2d(3, 2, 1, ceil_mode=True)(i); nn.MaxPool3d(2)(d);
    nn.MaxUnpool1d(2)(*F.max_pool1d(s, 2, return_indices=True));
    nn.MaxUnpool2d(2)(*F.max_pool2d(i, 2, return_indices=True));
    nn.MaxUnpool3d(2)(*F.max_pool3d(d, 2, return_indices=True)); nn.MultiLabelMarginLoss()(x[:, :7], k[:, :7] % 7);
    nn.MultiLabelSoftMarginLoss()(x, k.float() % 2); nn.MultiMarginLoss()(x, k[:, 0]);
    nn.MultiheadAttention(8, 2, batch_first=True)(s, s, s);
    nn.MultiheadAttention(8, 2, dropout=0.1)(s, s, s, need_weights=False); nn.NLLLoss()(F.log_softmax(x, 1), k[:, 0]);
    nn.NLLLoss2d()(F.log_softmax(i, 1), k[0, :576].reshape(4, 12, 12) % 8); nn.PoissonNLLLoss()(x, p);
    nn.RMSNorm(12)(i); nn.RNN(8, 10, batch_first=True)(s); nn.Sequential(nn.Linear(8, 8), nn.SiLU(), nn.Sigmoid())(s);
    nn.SoftMarginLoss()(x, y.sign().detach()); nn.Softmax2d()(i); nn.SyncBatchNorm(8).eval()(i);
    nn.Threshold(0.5, 0.1)(x); nn.Transformer(8, 2, 1, 1, 16, batch_first=True)(s, s.flip(1));
    nn.TransformerEncoder(nn.TransformerEncoderLayer(8, 2, 16, batch_first=True), 2)(s);
    nn.TransformerDecoder(nn.TransformerDecoderLayer(8, 2, 16, batch_first=True), 2)(s, s.flip(1));
    nn.Unflatten(1, (2, 4))(i); nn.ModuleDict({'a': nn.Linear(8, 8)})['a'](nn.ModuleList([nn.Linear(8, 8)])[0](s));
    nn.ParameterDict({'a': nn.Parameter(torch.ones(8))})['a'] * s + nn.ParameterList([torch.ones(8)])[0];
    nn.Buffer(torch.ones(8)) * s; nn.utils.weight_norm(nn.Conv2d(8, 16, 3))(i);
    nn.utils.spectral_norm(nn.Conv2d(8, 16, 3))(i); nn.utils.parameters_to_vector([s, i]);
    nn.utils.parametrizations.weight_norm(nn.Conv2d(8, 16, 3))(i);
    nn.utils.parametrizations.spectral_norm(nn.Conv2d(8, 16, 3))(i);
    nn.utils.parametrizations.orthogonal(nn.Linear(8, 8))(s);
    nn.init.calculate_gain('selu') * nn.init.constant_(torch.empty(9), 0.3);
    nn.init.ones_(torch.empty(9)) + nn.init.zeros_(torch.empty(9)); nn.init.dirac_(torch.empty(8, 8, 3, 3));
    nn.init.eye_(torch.empty(8, 8)); nn.init.sparse_(torch.empty(60, 80), 0.3);
    nn.init.trunc_normal_(torch.empty(60, 80), std=0.02); torch.pow(P.detach(), 0.5, out=torch.empty(0));
    torch.tan(X.detach().double(), out=torch.empty(0).double()); nn.LPPool2d(2, 2)(i.double()); P.double() ** 0.5
"""

_NOT_NUMERIC = """
    Tensor Size Generator device dtype memory_format layout finfo iinfo is_tensor is_floating_point is_complex
    is_grad_enabled no_grad enable_grad inference_mode float float16 float32 float64 half double bfloat16 int int8
    int16 int32 int64 uint8 long short bool cfloat complex64 complex128 channels_last contiguous_format
    preserve_format strided pi e inf nan tensor as_tensor zeros_like ones_like full_like empty empty_like eye fill
    randint_like numel result_type tril_indices triu_indices broadcast_tensors broadcast_to atleast_1d atleast_2d
    atleast_3d chunk skip_init clone detach dsplit flatten hsplit moveaxis movedim narrow permute ravel reshape
    select split squeeze swapaxes swapdims t transpose unflatten unsqueeze view vsplit asin_ Module Container
    Parameter UninitializedBuffer UninitializedParameter RNNBase RNNCellBase LinearCrossEntropyOptions
"""

#: Allowed names that compute no number: types, constants, switches, views, copies, containers and abstract bases.
NOT_NUMERIC = frozenset(_NOT_NUMERIC.split())

_WORD = re.compile(r"[A-Za-z_]\w*")


def expressions() -> Iterator[str]:
    """Return every expression, each once."""
    for operand, names in _UNARY.items():
        yield from (_unary(name, operand) for name in names.split())
        yield from (f"torch.{name}(({operand}).double())" for name in names.split() if name in _TRANSCENDENTAL.split())
    yield from (f"torch.{name}({'p' if name in ('pow', 'float_power') else 'x'}, y)" for name in _BINARY.split())
    yield from (f"torch.{name}(x, dim=1)" for name in _ALONG_AXIS.split())
    yield from (f"torch.{name}({operand}.detach(), out=torch.empty(0))" for name, operand in _INTO.items())
    yield from (f"x * math.{name}(0.7)" for name in _MATH.split())
    yield from (call.replace("{}", name) for call, names in _CALLS.items() for name in names.split())
    yield from (call.strip() for text in (_FURTHER, _LAYERS) for call in text.split(";"))


def names() -> frozenset[str]:
    """Return every word that some expression uses, or that computes nothing."""
    return NOT_NUMERIC.union(*(_WORD.findall(expression) for expression in expressions()))


def _unary(name: str, operand: str) -> str:
    """Write the call of a function of one operand; one needs a second."""
    return f"torch.{name}({operand}, 2)" if name == "rsub" else f"torch.{name}({operand})"
