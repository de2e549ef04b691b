# Weights of upstream networks: snakemake weights_list says what the settings ask for, snakemake weights fetches and verifies it.
# Nothing else in the workflow fetches anything, and neither is part of a plain run.


rule weights_list:
    log:
        "logs/weights/list.log",
    benchmark:
        "benchmarks/weights/list.tsv"
    localrule: True
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=500,
    params:
        code=code("models.weights"),
        models=SELECTED,
        weights=WEIGHTS,
    shell:
        "python -m studiorecon models.weights --log {log} --models {params.models:q} --weights {params.weights:q} --fetching no"


rule weights:
    log:
        "logs/weights/fetch.log",
    benchmark:
        "benchmarks/weights/fetch.tsv"
    localrule: True
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=500,
    params:
        code=code("models.weights"),
        models=SELECTED,
        weights=WEIGHTS,
    shell:
        "python -m studiorecon models.weights --log {log} --models {params.models:q} --weights {params.weights:q} --fetching yes"


if BODY != GIVEN_BODY:

    rule body_plain:
        input:
            pickle=GIVEN_BODY,
        output:
            body=BODY,
        log:
            "logs/body/plain.log",
        benchmark:
            "benchmarks/body/plain.tsv"
        container:
            image("core")
        threads: 1
        resources:
            mem_mb=1000,
        params:
            code=code("models.smpl"),
        shell:
            "python -m studiorecon models.smpl --log {log} --pickle {input.pickle:q} --body {output.body:q}"
