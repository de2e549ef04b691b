# Planner: what the calibrated cameras see of their room, and which to move where. snakemake plan --config dataset=DIR
# Part of no other target. Where to put cameras before filming needs no dataset: studiorecon plan --room 6x5x2.8


rule placement_advise:
    input:
        model=MODEL,
    output:
        picture="results/{scene}/placement/advice.svg",
        plan="results/{scene}/placement/advice.json",
    log:
        "logs/{scene}/placement/advise.log",
    benchmark:
        "timings/{scene}/placement/advise.tsv"
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=memory(500),
    params:
        code=code("placement.advise"),
    shell:
        command("placement.advise")


rule plan:
    input:
        f"results/{PLAN.scene}/placement/advice.svg",
    localrule: True
