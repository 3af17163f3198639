"""Reports: what a run came to, for people to read."""

from typing import TYPE_CHECKING

from scuhand_bt.fronts import front

if TYPE_CHECKING:
    from scuhand_bt.report.audit import deeds_in_lab, deeds_of_run
    from scuhand_bt.report.backup import back_up, restore
    from scuhand_bt.report.changer import changer_lines
    from scuhand_bt.report.dose_curves import curves_of_doses
    from scuhand_bt.report.dose_plot import plot_dose
    from scuhand_bt.report.doses import amount_cell, asked_cells, asked_mg, composed_lines, doses_table, said_of
    from scuhand_bt.report.live import LiveView, PlainLines, end_line
    from scuhand_bt.report.live_terminal import LiveTerminal
    from scuhand_bt.report.move_page import page_of_move
    from scuhand_bt.report.move_picture import move_png
    from scuhand_bt.report.picture import Picture
    from scuhand_bt.report.preview import preview_page
    from scuhand_bt.report.proof import NO_CHAIN, proof_of
    from scuhand_bt.report.reach import reach_page
    from scuhand_bt.report.run_report import comparison, page_of_run, write_pdf
    from scuhand_bt.report.run_story import chain_line, header_lines, told
    from scuhand_bt.report.scoop_reach import directions
    from scuhand_bt.report.show_move import shown_move
    from scuhand_bt.report.study_plot import plot_study
    from scuhand_bt.report.watching import shown_of
    from scuhand_bt.report.weighing_record import weighing_csv, weighing_lines
else:
    __getattr__, __dir__ = front(
        __name__,
        {
            "report.audit": "deeds_in_lab deeds_of_run",
            "report.backup": "back_up restore",
            "report.changer": "changer_lines",
            "report.dose_curves": "curves_of_doses",
            "report.dose_plot": "plot_dose",
            "report.doses": "amount_cell asked_cells asked_mg composed_lines doses_table said_of",
            "report.live": "LiveView PlainLines end_line",
            "report.live_terminal": "LiveTerminal",
            "report.move_page": "page_of_move",
            "report.move_picture": "move_png",
            "report.picture": "Picture",
            "report.preview": "preview_page",
            "report.proof": "NO_CHAIN proof_of",
            "report.reach": "reach_page",
            "report.run_report": "comparison page_of_run write_pdf",
            "report.run_story": "chain_line header_lines told",
            "report.scoop_reach": "directions",
            "report.show_move": "shown_move",
            "report.study_plot": "plot_study",
            "report.watching": "shown_of",
            "report.weighing_record": "weighing_csv weighing_lines",
        },
    )

__all__ = [
    "NO_CHAIN",
    "LiveTerminal",
    "LiveView",
    "Picture",
    "PlainLines",
    "amount_cell",
    "asked_cells",
    "asked_mg",
    "back_up",
    "chain_line",
    "changer_lines",
    "comparison",
    "composed_lines",
    "curves_of_doses",
    "deeds_in_lab",
    "deeds_of_run",
    "directions",
    "doses_table",
    "end_line",
    "header_lines",
    "move_png",
    "page_of_move",
    "page_of_run",
    "plot_dose",
    "plot_study",
    "preview_page",
    "proof_of",
    "reach_page",
    "restore",
    "said_of",
    "shown_move",
    "shown_of",
    "told",
    "weighing_csv",
    "weighing_lines",
    "write_pdf",
]
