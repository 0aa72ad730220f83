"""
Liu 2014, Figs 12 to 14: descriptors, geometry, both
====================================================

Three nearest neighbours on Fourier descriptors (Fig. 12), on geometry (Fig. 13) and on
both (Fig. 14), for the paper's sets of classes. Hollow marks are the paper's figures,
where its text gives them. Descriptors are about as good as the paper's; geometry is
easier on simulated presses. Z-scored, forty descriptors outvote the two numbers of
geometry; raw, the area outvotes the descriptors. Two runs of cross-validation here, ten
on the page of the study, which says what was tried to explain the difference.
"""

from palpate.studies import liu2014, run_study

less = {"protocol": "nested", "loads_kgf": (), "covers_mm": ()}
result = run_study("liu2014", quick=True, **less)
for row in result["rows"]:
    if row["data"] == "simulated" and row["paper"] and row["table"].startswith("Fig"):
        name = f"{row['name']}, {row['features']}"
        print(f"{name}: {row['ours']:.1f} %, in the paper {row['paper']:g} %")
figure = liu2014.draw_class_sets(result["rows"])
