// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstddef>

#include "entity_manager/core/journal/journal_writer.hpp"
#include "entity_manager/core/stops/stop_ledger.hpp"
#include "entity_manager/core/turn/incident.hpp"

namespace axon::entity_manager {

/// How a stop is carried out, once its row of the state table or the signal thread says that there is one.
///
/// Every stop goes through the same three steps, in this order: StopLedger has its generation and has it
/// commanded, what the tasks know of stops is brought up to date, and the journal has its entry. Whoever
/// asked for it is then told by its receipt, which the row orders separately, since not every stop has
/// somebody to tell. A stop that no application could carry out is ordered once more when one links. Threads:
/// the core's strand.
class StopOrders {
  public:
    /// What it asks of other owners.
    class Others {
      public:
        struct TaskCounts {
            std::size_t begun = 0;
            std::size_t waiting = 0;
        };
        virtual ~Others() = default;
        /// There is a newer stop generation. `ends`: the robot application is no longer busy by its own
        /// account; false for a reset, after which it may go on.
        virtual void stopReachesTasks(bool ends) = 0;
        virtual TaskCounts taskCounts() const = 0;
        /// As far as is known.
        virtual bool robotMoves() const = 0;
    };
    StopOrders(Others& others, StopLedger& ledger, JournalWriter& journal)
        : others_(others), ledger_(ledger), journal_(journal) {}

    /// To a request that ends tasks: as which stop it does so, and what those are told who lose a task or a
    /// lease by it.
    static void giveReason(Incident& request);

    // Actions of the state table.

    /// Orders a stop of the Entity Manager's own; the incident has its generation afterwards.
    void stop(Incident& incident);
    /// Opens the receipt, for whoever asked for the stop and for the holder.
    void acknowledge(const Incident& incident);
    /// What was ordered while the application was lost is given to it now that it is back: it has stopped by
    /// itself when its link ended, but another process may be in its place.
    void deliver();

    /// The signal thread has raised this stop and has passed it on. Call it before the row of the stop is
    /// looked for.
    void arrived(const Incident& incident);

  private:
    void note(const Incident& incident);

    Others& others_;
    StopLedger& ledger_;
    JournalWriter& journal_;
};

}  // namespace axon::entity_manager
