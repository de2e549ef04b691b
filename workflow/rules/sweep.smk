# What accuracy costs: snakemake --cores all sweep --config dataset=DIR sweep=config/sweeps/one_at_a_time.tsv
# runs every configuration of that table and makes results/SCENE/sweep/TABLE/index.html. Part of no other target.


rule sweep_run:
    input:
        table=local(beside(config["sweep"], HOME)),
    output:
        records="results/{scene}/sweep/{table}/records.jsonl",
    log:
        "logs/{scene}/sweep/{table}/run.log",
    benchmark:
        "timings/{scene}/sweep/{table}/run.tsv"
    handover: True
    # It starts Snakemake again, which has no place inside a step's image, and gets every core: seconds are only worth comparing
    # when nothing else runs beside them.
    container:
        None
    threads: every_core
    resources:
        mem_mb=6000,
    params:
        code=code("sweep.run"),
        configuration=json.dumps(config, sort_keys=True),
        minutes=config["sweep_minutes"],
        presets=HOME / "config/presets",
        snakefile=HOME / "Snakefile",
        work="results/{scene}/sweep/{table}/runs",
    shell:
        command("sweep.run")


rule sweep_page:
    input:
        records="results/{scene}/sweep/{table}/records.jsonl",
        solvers=HOME / "resources/solvers.tsv",
    output:
        page=report(
            "results/{scene}/sweep/{table}/index.html",
            caption="../report/sweep.rst",
            category="What accuracy costs",
        ),
        table="results/{scene}/sweep/{table}/sweep.csv",
    log:
        "logs/{scene}/sweep/{table}/page.log",
    benchmark:
        "timings/{scene}/sweep/{table}/page.tsv"
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=500,
    params:
        code=code("sweep.page"),
    shell:
        command("sweep.page")


rule sweep:
    input:
        f"results/{PLAN.scene}/sweep/{Path(config['sweep']).stem}/index.html",
    localrule: True
