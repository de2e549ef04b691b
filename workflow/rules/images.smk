# Container images: snakemake images builds those that the settings ask for, with whatever engine this machine has. Not part of a plain run.


rule images:
    log:
        "logs/images/build.log",
    benchmark:
        "benchmarks/images/build.tsv"
    localrule: True
    # What builds images cannot run in one of them.
    container:
        no_container
    threads: 1
    resources:
        mem_mb=1000,
    params:
        code=code("models.containers"),
        images=[f"{name}={IMAGES[name]['image']}:{IMAGES[name]['version']}" for name in IMAGES_USED],
        root=workflow.basedir,
        folder=config["images"],
    shell:
        "python -m studiorecon models.containers --log {log} --images {params.images:q} --root {params.root:q} --folder {params.folder:q}"
