"""The paper's samplers: adaptive Metropolis with Gibbs steps, on a compliance and on a network's weights."""
