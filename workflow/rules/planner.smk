# Planner: what the calibrated cameras see of their room, and which to move where. snakemake plan --config dataset=DIR
# Part of no other target. Where to put cameras before filming needs no dataset: studiorecon plan --room 6x5x2.8


rule planner_advise:
    input:
        model=MODEL,
    output:
        picture="results/{scene}/planner/advice.svg",
        plan="results/{scene}/planner/advice.json",
    log:
        "logs/{scene}/planner/advise.log",
    benchmark:
        "benchmarks/{scene}/planner/advise.tsv"
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=500,
    params:
        code=code("planner.advise"),
    shell:
        command("planner.advise")


rule plan:
    input:
        f"results/{PLAN.scene}/planner/advice.svg",
    localrule: True
