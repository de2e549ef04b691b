# What accuracy costs: snakemake --cores all sweep --config dataset=DIR sweep=config/sweeps/one_at_a_time.tsv
# runs every configuration of that table and makes results/SCENE/sweep/TABLE/index.html. Part of no other target.


rule sweep_row:
    input:
        table=local(resolve_path(config["sweep"], HOME)),
        base=base_record,
    output:
        record="results/{scene}/sweep/{table}/{row}.json",
    log:
        "logs/{scene}/sweep/{table}/{row}.log",
    benchmark:
        "timings/{scene}/sweep/{table}/{row}.tsv"
    handover: True
    # It starts Snakemake again, which has no place inside a step's image, and gets every core: seconds are only worth comparing
    # when nothing else runs beside them.
    container:
        None
    threads: every_core
    resources:
        mem_mb=memory(6000),
    params:
        code=code("sweep.row"),
        configuration=json.dumps(config, sort_keys=True),
        minutes=config["sweep_minutes"],
        presets=HOME / "config/presets",
        snakefile=HOME / "Snakefile",
        work="results/{scene}/sweep/{table}/runs",
    shell:
        command("sweep.row")


rule sweep_page:
    input:
        records=sweep_records,
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
        mem_mb=memory(500),
    params:
        code=code("sweep.page"),
    shell:
        command("sweep.page")


rule sweep:
    input:
        f"results/{PLAN.scene}/sweep/{Path(config['sweep']).stem}/index.html",
    localrule: True
