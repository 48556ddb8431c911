"""The methods by name, without their code: what a command line lists."""

METHODS = {
    "gvr-paper": "the paper's method",
    "gvr-robust": "the same idea with the weak places mended, each by a switch of its own",
    "lift": "baseline of another school: view features lifted onto the Gaussians",
    "random-patch": "control: the paper's method with a random patch retrieved in each view",
}
"""Name -> one line on what it is; each can answer a question that nobody has asked before."""
