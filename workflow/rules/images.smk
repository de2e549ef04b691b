# Container images: snakemake images builds those that the settings ask for, with whatever engine this machine has. Not part of a plain run.


rule images:
    log:
        "logs/images/build.log",
    benchmark:
        "timings/images/build.tsv"
    localrule: True
    # What builds images cannot run in one of them.
    container:
        no_container
    threads: 1
    resources:
        mem_mb=memory(1000),
    params:
        code=code("models.containers"),
        images=IMAGES.to_build(PLAN.networks.images),
        root=str(HOME),
        folder=config["images"],
    shell:
        command("models.containers")
