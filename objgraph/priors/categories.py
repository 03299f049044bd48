"""What data sets call the categories that there are shape priors for: the one table of names."""

LABELS: dict[str, tuple[str, ...]] = {
    "chair": ("armchair", "office chair", "stool", "bar stool", "swivel chair", "seat", "03001627"),
    "table": ("desk", "coffee table", "dining table", "end table", "side table", "conference table", "04379243"),
    "sofa": ("couch", "loveseat", "sofa chair", "04256520"),
    "bed": ("bunk bed", "02818832"),
    "cabinet": (
        "file cabinet", "kitchen cabinet", "bathroom cabinet", "nightstand", "dresser", "wardrobe", "tv stand",
        "sideboard", "cupboard", "chest of drawers", "02933112",
    ),
    "bookshelf": ("bookcase", "shelf", "bookshelves", "02871439"),
    "display": ("monitor", "tv", "television", "computer monitor", "screen", "03211117"),
    "bathtub": ("tub", "bath", "02808440"),
    "trash_bin": (
        "trash can", "trash bin", "recycling bin", "garbage can", "garbage bin", "bin", "ashcan", "wastebasket",
        "02747177",
    ),
    "car": (
        "automobile", "sedan", "hatchback", "suv", "van", "minivan", "pickup", "pickup truck", "taxi", "02958343",
    ),
}  # fmt: skip
"""By category the labels of ScanNet, COCO, ADE20K, KITTI and alike that mean it, and ShapeNet's id (Scan2CAD's)."""

ALIASES = {label: category for category, labels in LABELS.items() for label in labels}


def category_of(label: str) -> str:
    """The category that a label means; a label that no category has is its own, in lower case."""
    name = label.strip().lower()
    spaced = name.replace("_", " ")
    return name if name in LABELS else ALIASES.get(spaced, name)


def plain(name: str) -> str:
    """A category's name as it is compared with another, however it is spelt."""
    return name.strip().lower().replace("_", " ")
