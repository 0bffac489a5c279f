"""Adam without torch's compiler: nothing here is compiled, and to import it takes seconds of every process."""

from inspect import unwrap

import torch


class Adam(torch.optim.Adam):
    """Its methods as they are written, without the wrappers that import ``torch._dynamo`` when first called."""

    step = torch.no_grad()(unwrap(torch.optim.Adam.step))
    zero_grad = unwrap(torch.optim.Adam.zero_grad)
    state_dict = unwrap(torch.optim.Adam.state_dict)
    load_state_dict = unwrap(torch.optim.Adam.load_state_dict)
    add_param_group = unwrap(torch.optim.Adam.add_param_group)
