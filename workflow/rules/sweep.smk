# What accuracy costs: snakemake --cores all sweep --config dataset=DIR sweep=config/sweeps/one_at_a_time.tsv
# runs every configuration of that table and makes results/SCENE/sweep/TABLE/index.html. Part of no other target.


rule sweep_run:
    input:
        table=beside_workflow(config["sweep"]),
    output:
        records="results/{scene}/sweep/{table}/records.jsonl",
    log:
        "logs/{scene}/sweep/{table}/run.log",
    benchmark:
        "benchmarks/{scene}/sweep/{table}/run.tsv"
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
        presets=Path(workflow.basedir) / "config/presets",
        snakefile=Path(workflow.basedir) / "Snakefile",
        work=subpath(output.records, parent=True),
    shell:
        "python -m studiorecon sweep.run --log {log}"
        " --configuration {params.configuration:q} --scene {wildcards.scene:q} --table {input.table:q} --presets {params.presets:q}"
        " --snakefile {params.snakefile:q} --cores {threads} --minutes {params.minutes}"
        " --records {output.records:q} --work {params.work:q}/runs"


rule sweep_page:
    input:
        records="results/{scene}/sweep/{table}/records.jsonl",
        solvers=Path(workflow.basedir) / "resources/solvers.tsv",
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
        "benchmarks/{scene}/sweep/{table}/page.tsv"
    container:
        image("core")
    threads: 1
    resources:
        mem_mb=500,
    params:
        code=code("report.sweep"),
    shell:
        "python -m studiorecon report.sweep --log {log}"
        " --records {input.records:q} --solvers {input.solvers:q} --page {output.page:q} --table {output.table:q}"


rule sweep:
    input:
        f"results/{SCENE}/sweep/{Path(config['sweep']).stem}/index.html",
    localrule: True
