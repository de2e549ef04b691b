# Weights of upstream networks: snakemake weights_list says what the settings ask for, snakemake weights fetches and verifies it.
# Nothing else in the workflow fetches anything, and neither is part of a plain run.


rule weights_list:
    log:
        "logs/weights/list.log",
    benchmark:
        "timings/weights/list.tsv"
    localrule: True
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=memory(500),
    params:
        code=code("models.weights"),
        models=PLAN.networks.selected,
        weights=PLAN.networks.weights,
        fetching="no",
    shell:
        command("models.weights")


rule weights:
    log:
        "logs/weights/fetch.log",
    benchmark:
        "timings/weights/fetch.tsv"
    localrule: True
    container:
        image("vision")
    threads: 1
    resources:
        mem_mb=memory(500),
    params:
        code=code("models.weights"),
        models=PLAN.networks.selected,
        weights=PLAN.networks.weights,
        fetching="yes",
    shell:
        command("models.weights")
