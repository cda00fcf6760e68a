"""From a jaxpr to LLVM IR: the forms of arrays, what is unrolled, and the rules applied equation by equation."""
