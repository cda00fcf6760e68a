"""From a jaxpr to LLVM's language: how arrays are held, what is unrolled, how a jaxpr is walked."""
